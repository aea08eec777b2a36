"""What all tests share: the same examples in every run, and a log that no other test has turned down."""

import logging
from collections.abc import Iterator

import pytest
from hypothesis import settings

settings.register_profile("same", derandomize=True, deadline=None)  # a new seed is a decision, not an accident
settings.load_profile("same")


_LOG = logging.getLogger("elastocal")
_HANDLERS, _LEVEL = tuple(_LOG.handlers), _LOG.level


@pytest.fixture(autouse=True)
def _plain_log() -> Iterator[None]:
    """Commands set up the log of their process, some of them quietly; every test starts without that.

    Fixtures of a whole module may have run commands too, so it is put back before a test as well.
    """
    _put_back()
    yield
    _put_back()


def _put_back() -> None:
    """The log as it was before any command ran."""
    _LOG.handlers = list(_HANDLERS)
    _LOG.setLevel(_LEVEL)
