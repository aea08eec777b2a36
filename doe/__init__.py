"""The design of experiments."""

from __future__ import annotations

import importlib
from typing import Any

_HOME = {  # public name -> module that defines it; loaded at the first use, so that ``import doe`` is quick
    "ApproximateDesign": "doe.approximate",
    "ExactDesign": "doe.exact",
    "NextPoses": "doe.discriminate",
    "approximate_design": "doe.approximate",
    "exact_design": "doe.exact",
    "next_poses": "doe.discriminate",
}

__all__ = [  # noqa: F822
    "ApproximateDesign",
    "ExactDesign",
    "NextPoses",
    "approximate_design",
    "exact_design",
    "next_poses",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its module (PEP 562)."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Public names."""
    return sorted(__all__)
