"""The command `report`: the results of a folder as one HTML file."""

from __future__ import annotations

from pathlib import Path

from doe.report.folder import Entry, Folder, read_folder
from doe.report.other_sections import other_sections, provenance_section
from doe.report.page import MADE_BY, element, page
from doe.report.sections import diagnosis_sections
from doe.report.words import verdict_words
from identify.commands import Outcome
from identify.errors import InputError

__all__ = ["REPORT", "check_report", "report_html", "run_report"]

REPORT = "report.html"
_HEAD = 2000  # bytes in which the mark stands


def run_report(folder: Path) -> Outcome:
    """Make the report of a folder.

    Args:
        folder: Folder with results; `check_report` has passed.

    Raises:
        InputError: No results in it, or results that cannot be read.
    """
    found = read_folder(folder)
    text = report_html(found)
    size = len(text.encode("utf-8"))
    content = {"report": REPORT, "bytes": size, "results": list(found.results)}
    diagnosis = found.results.get("diagnose")
    said = () if diagnosis is None else (verdict_words(diagnosis),)
    return Outcome("report", content, found.inputs, {REPORT: text}, (*said, f"{REPORT}: {size / 1000:.0f} kB"))


def check_report(folder: Path, force: bool) -> None:
    """Stop if a file of another origin would be replaced.

    Raises:
        InputError: ``report.html`` is there and is no report of ours, and ``force`` is off.
    """
    there = folder / REPORT
    if force or not there.is_file():
        return
    with there.open("rb") as stream:
        if MADE_BY.encode() not in stream.read(_HEAD):
            raise InputError(f"{there}: is there and was not made by elastocal report; rename it or give --force")


def report_html(folder: Folder) -> str:
    """The report as text."""
    diagnosis = folder.results.get("diagnose")
    title = _title(diagnosis)
    head = element("p", title, class_="top")
    sections = [] if diagnosis is None else diagnosis_sections(diagnosis, folder)
    first = [] if sections else [element("h1", "Results")]
    return page(title, head, *first, *sections, *other_sections(folder), provenance_section(folder))


def _title(diagnosis: Entry | None) -> str:
    """Name of the page."""
    measured = None if diagnosis is None else diagnosis.get("measured")
    return "elastocal report" if measured is None else f"elastocal report: {measured['robot']}"
