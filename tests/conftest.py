"""What all tests share: the same examples in every run, and a log that no other test has turned down."""

import logging
from collections.abc import Iterator

import pytest
from hypothesis import settings

settings.register_profile("same", derandomize=True, deadline=None)  # a new seed is a decision, not an accident
settings.load_profile("same")


@pytest.fixture(autouse=True)
def _plain_log() -> Iterator[None]:
    """Commands set up the log of their process, some of them quietly; the next test starts without that."""
    log = logging.getLogger("elastocal")
    handlers, level = list(log.handlers), log.level
    yield
    log.handlers, log.level = handlers, level
    log.setLevel(level)
