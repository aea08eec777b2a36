"""Shared builders of this folder can be imported; all small matrices take one thread.

A second thread only waits, and the tests run two at a time.
"""

import sys
from pathlib import Path

import pytest
from threadpoolctl import threadpool_limits

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(autouse=True, scope="session")
def _one_thread():
    with threadpool_limits(1):
        yield
