"""Every notebook runs from start to end, asserts included, and only scripts are committed."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import jupytext
import pytest
from nbclient import NotebookClient

ROOT = Path(__file__).parents[1]
SCRIPTS = sorted((ROOT / "notebooks").glob("*.py"))
TIMEOUT = 600  # s
MEASURED = ROOT.parent / "shared" / "data"  # real measurements, not part of the project


@pytest.fixture
def kernel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Name of a kernel that is this very Python; whatever jupyter writes stays in the temporary folder."""
    home = tmp_path / "home"
    for key in (
        "HOME", "IPYTHONDIR", "JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "JUPYTER_RUNTIME_DIR", "MPLCONFIGDIR",
        "XDG_CACHE_HOME",
    ):  # fmt: skip
        folder = home / key.lower()
        folder.mkdir(parents=True)
        monkeypatch.setenv(key, str(folder))
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    monkeypatch.delenv("JUPYTER_PATH", raising=False)
    folder = home / "jupyter_data_dir" / "kernels" / "elastocal"
    folder.mkdir(parents=True)
    argv = [sys.executable, "-m", "ipykernel_launcher", "-f", "{connection_file}"]
    spec = {"argv": argv, "display_name": "elastocal", "language": "python"}
    (folder / "kernel.json").write_text(json.dumps(spec), encoding="utf-8")
    return folder.name


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_notebook_runs_to_its_last_assert(script: Path, kernel: str, tmp_path: Path) -> None:
    if "shared/data" in script.read_text(encoding="utf-8"):
        if not MEASURED.is_dir():
            (pytest.fail if os.environ.get("CI") else pytest.skip)("needs the measurements in ../shared/data")
        (tmp_path / "shared").symlink_to(MEASURED.parent)
    clone = tmp_path / "clone"
    shutil.copytree(ROOT / "configs", clone / "configs")
    (clone / "notebooks").mkdir()
    notebook = jupytext.read(script)
    resources = {"metadata": {"path": str(clone / "notebooks")}}
    NotebookClient(notebook, kernel_name=kernel, timeout=TIMEOUT, resources=resources).execute()
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(cell.execution_count for cell in code)
    assert "assert " in code[-1].source, "the story ends in asserts"
    shown = [key for cell in code for output in cell.outputs for key in output.get("data", {})]
    assert "image/png" in shown, "pictures are shown"
    assert not list((clone / "notebooks").iterdir()), "nothing is written beside the notebook"


def test_notebooks_exist_and_begin_with_their_parameters() -> None:
    assert SCRIPTS
    for script in SCRIPTS:
        first = next(cell for cell in jupytext.read(script).cells if cell.cell_type == "code")
        assert "parameters" in first.metadata.get("tags", []), f"{script.name}: parameters stand in the first cell"
        assert "/home/" not in script.read_text(encoding="utf-8")


def test_only_scripts_are_committed() -> None:
    names = [path.name for path in (ROOT / "notebooks").rglob("*")]
    if (ROOT / ".git").exists() and shutil.which("git"):  # else an unpacked archive
        listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False)
        names = listed.stdout.splitlines() if listed.returncode == 0 else names
    assert not [name for name in names if name.endswith(".ipynb")]
