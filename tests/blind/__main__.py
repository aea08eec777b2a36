"""Blind exam: ``python -m tests.blind --cases 300``.

One case to look at: ``python -m tests.blind --write DIR --seed 7 --kinds geometry``.
"""

import argparse
import json
import secrets
import sys
import time
from pathlib import Path

from tests.blind.cases import make_case, write_case
from tests.blind.exam import run_exam
from tests.blind.shell import COMMAND
from tests.blind.targets import report


def main() -> int:
    """Run the exam; 1 if a promise is refuted."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.blind", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=300)
    parser.add_argument("--seed", type=int, default=None, help="fresh by default")
    parser.add_argument("--kinds", nargs="*", default=[], help="taken in turn; by the mix if none")
    parser.add_argument(
        "--options", type=json.loads, default={}, help='of a case, as JSON: {"poses": 15, "free": true}'
    )
    parser.add_argument("--json", type=Path, help="save all outcomes here")
    parser.add_argument("--alpha", type=float, default=0.01, help="level at which a promise counts as refuted")
    parser.add_argument("--quick", action="store_true", help="no held-out errors and no extra poses")
    parser.add_argument("--without", action="store_true", help="also with the true effect out of the library")
    parser.add_argument("--command", type=Path, default=COMMAND)
    parser.add_argument("--write", type=Path, help="write the first case into this folder, and run nothing")
    given = parser.parse_args()
    seed = secrets.randbelow(10**6) * 1000 if given.seed is None else given.seed
    print(f"seed {seed}", flush=True)
    if given.write:
        case = make_case(seed, given.kinds[0] if given.kinds else None, **given.options)
        print(write_case(case, given.write), json.dumps(case.truth, default=float))
        return 0
    start, seeds = time.perf_counter(), range(seed, seed + given.cases)
    how = {"more": not given.quick, "without": given.without, "options": given.options}
    outcomes = run_exam(seeds, given.kinds, command=given.command, **how)
    text, broken = report(outcomes, given.alpha)
    print(f"{text}\n{given.cases} cases in {time.perf_counter() - start:.0f} s, seed {seed}")
    for outcome in outcomes:
        if "error" in outcome:
            print(f"seed {outcome['seed']} {outcome['kind']}: {outcome['error']}")
    if given.json:
        given.json.write_text(json.dumps(outcomes, default=float, indent=1))
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
