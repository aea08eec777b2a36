"""Run all benchmarks: ``python -m benchmarks [name ...]``.

They print measured figures beside what is wanted of them. Nothing here decides whether tests pass.
"""

from __future__ import annotations

import importlib
import sys

NAMES = ("blocks", "cell", "compensation", "complete", "design", "dual", "fit", "peers", "whole")


def main() -> None:
    """Run the named benchmarks, all by default."""
    for name in sys.argv[1:] or NAMES:
        print(f"== {name}", flush=True)
        importlib.import_module(f"benchmarks.{name}").main()


if __name__ == "__main__":
    main()
