"""Put what `make demo` and `make cell` print into the README: `python docs/make_readme.py`.

The commands are those of these targets in the Makefile; they run in a temporary folder with a copy of `configs`.
"""

from __future__ import annotations

import io
import logging
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path

from doe.cli import run

__all__ = ["ROOT", "block", "demo_commands", "demo_sections", "run_demo", "section_of"]

ROOT = Path(__file__).resolve().parents[1]


def demo_commands(target: str = "demo") -> list[str]:
    """Command lines of a target, as make prints them."""
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    values = dict(re.findall(r"^(\w+) :?\??= *(.*)$", makefile, flags=re.MULTILINE))
    recipe = re.search(rf"^{target}:.*\n((?:\t.*\n)+)", makefile, flags=re.MULTILINE)
    if recipe is None:
        raise SystemExit(f"the Makefile has no target {target}")
    lines = [line.strip() for line in recipe[1].splitlines()]
    for _ in values:  # a variable may stand for others
        lines = [re.sub(r"\$\((\w+)\)", lambda found: values[found[1]], line) for line in lines]
    return lines


def run_demo(folder: Path, target: str = "demo") -> list[tuple[str, str]]:
    """Run the commands of a target in a folder.

    Args:
        folder: Where to run; gets a copy of `configs` and the results in `out`.
        target: demo or cell.

    Returns:
        Each command line with what it printed on stdout.
    """
    shutil.copytree(ROOT / "configs", folder / "configs")
    printed = []
    with _working_in(folder):
        for line in demo_commands(target):
            out, err = io.StringIO(), io.StringIO()
            with redirect_stdout(out), redirect_stderr(err):
                code = run(line.split()[1:])
            if code != 0:
                raise SystemExit(f"{line}\nended with {code}\n{err.getvalue()}")
            printed.append((line, out.getvalue()))
    return printed


@contextmanager
def _working_in(folder: Path) -> Iterator[None]:
    """Work in another folder, with the handlers of our log put back afterwards."""
    before, log = Path.cwd(), logging.getLogger("elastocal")
    handlers, level = log.handlers, log.level
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)
        log.handlers = handlers
        log.setLevel(level)


def demo_sections(printed: list[tuple[str, str]]) -> dict[str, str]:
    """What stands between the marks of the README, by their name; the second study begins the diagnosis."""
    studies = [line.split()[2] for line, _ in printed]
    first = next(number for number, study in enumerate(studies) if study != studies[0])
    return {"demo": block(printed[:first]), "diagnosis": block(printed[first:])}


def block(printed: list[tuple[str, str]]) -> str:
    """Command lines with what they printed, as they stand in the README."""
    blocks = [f"$ {line}\n{text.rstrip()}\n" for line, text in printed]
    return "\n```text\n" + "\n".join(blocks) + "```\n"


def section_of(readme: str, name: str) -> tuple[str, str, str]:
    """The README before, between and after the marks of a section."""
    begin, end = f"<!-- {name}:begin -->", f"<!-- {name}:end -->"
    before, rest = readme.split(begin, 1)
    between, after = rest.split(end, 1)
    return before + begin, between, end + after


def main() -> None:
    """Rewrite the sections of the README."""
    with tempfile.TemporaryDirectory() as folder:
        sections = demo_sections(run_demo(Path(folder) / "demo"))
        sections["cell"] = block(run_demo(Path(folder) / "cell", "cell"))
    path = ROOT / "README.md"
    old = new = path.read_text(encoding="utf-8")
    for name, section in sections.items():
        before, _, after = section_of(new, name)
        new = before + section + after
    path.write_text(new, encoding="utf-8", newline="\n")
    print("README.md: nothing has changed" if old == new else "README.md: the printed output was renewed")


if __name__ == "__main__":
    main()
