"""Thread policy: small dense matrices are fastest on one thread."""

from __future__ import annotations

import functools
from typing import Any

__all__ = ["one_thread"]


@functools.cache
def _controller() -> Any:
    """The BLAS libraries of this process, found once."""
    import scipy.linalg  # noqa: F401  # brings its own BLAS, which must be seen too
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def one_thread() -> Any:
    """Context in which BLAS uses one thread; the former setting comes back afterwards.

    Two threads on a busy two-core machine make the Newton steps of this package several times slower,
    and the passes over all candidates are bound by memory, not by arithmetic.
    """
    return _controller().limit(limits=1, user_api="blas")
