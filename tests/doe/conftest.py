"""Lets the tests of this folder share `reference_cases` and `plain_design`, and counts exchanges."""

import sys
from pathlib import Path

import pytest

from doe import local_search

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture
def exchanges(monkeypatch):
    """List of the exchanges tried; the test fails after 5000, where a few hundred are usual."""
    tried, replaced = [], local_search._replaced

    def watched(*arguments):
        tried.append(1)
        assert len(tried) < 5000, "the exchange does not end"
        return replaced(*arguments)

    monkeypatch.setattr("doe.local_search._replaced", watched)
    return tried
