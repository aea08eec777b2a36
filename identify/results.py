"""Results on disk: JSON with provenance, written whole or not at all.

Two promises hold for the files of one command.

* *Whole or not at all.* All files are first written to a hidden folder and flushed to the disk. A new
  folder then appears by one rename. An existing folder that holds nothing but files of this result is
  exchanged for the new one in one step, where the system can do that. Else the hidden folder is
  sealed, and its files are moved over the old ones one by one, ``<command>.json`` last; if that is
  cut short, the next `check_out` or `recover` of the folder finishes it.
* *Other files are left alone.* Only files of the names that are written (or that the same command may
  have left earlier) are replaced; everything else in the folder stays as it is.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import json
import logging
import math
import os
import platform
import shutil
import sys
import tempfile
from collections.abc import Collection, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from identify.errors import InputError

__all__ = ["check_out", "json_text", "provenance", "recover", "write_results"]

SCHEMA = 1

_log = logging.getLogger("elastocal")

_SEALED = ".elastocal-sealed"  # a complete result that waits inside its folder
_OPEN = ".elastocal-"  # beginning of the names of unfinished folders
_REMOVE = ".remove"  # names of files that this result makes obsolete
_PACKAGES = ("elastocal", "numpy", "scipy", "pin", "casadi")


# ---- JSON


def json_text(data: Mapping[str, Any]) -> str:
    """A result as JSON text: ``schema`` first, then the keys in their order; nan and inf become null.

    Arrays, tuples and paths (their names only) may stand in ``data``. The same data give the same bytes.
    """
    return _dump({"schema": SCHEMA, **data}, "") + "\n"


def _dump(value: object, indent: str) -> str:
    """JSON of one value; lists of plain values stand in one line."""
    value = _plain(value)
    deeper = indent + "  "
    if isinstance(value, dict) and value:
        items = [f"{json.dumps(str(key), ensure_ascii=False)}: {_dump(item, deeper)}" for key, item in value.items()]
        return "{\n" + ",\n".join(deeper + item for item in items) + f"\n{indent}}}"
    if isinstance(value, list) and any(isinstance(_plain(item), dict | list) for item in value):
        return "[\n" + ",\n".join(deeper + _dump(item, deeper) for item in value) + f"\n{indent}]"
    if isinstance(value, list):
        return "[" + ", ".join(_dump(item, deeper) for item in value) + "]"
    return json.dumps(value, ensure_ascii=False, allow_nan=False)


def _plain(value: object) -> object:
    """A value in the types of JSON; only the outermost level of lists and mappings is converted."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, float):
        return value + 0.0 if math.isfinite(value) else None  # no minus zero
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, Path):
        return value.name
    return list(value) if isinstance(value, tuple) else value


def provenance(inputs: Sequence[Path], seed: int) -> dict[str, Any]:
    """What a result depends on: versions, seed and the SHA-256 of every input file, by its name.

    Nothing in it tells when or in which folder the run was. A second file of the same name and other
    content gets a number.

    Raises:
        InputError: An input file cannot be read.
    """
    hashes: dict[str, str] = {}
    for path in inputs:
        digest = _sha256(path)
        name, number = path.name, 1
        while hashes.get(name, digest) != digest:
            number += 1
            name = f"{path.name} ({number})"
        hashes[name] = digest
    versions = {name: _version(name) for name in _PACKAGES}
    return {"versions": {"python": platform.python_version(), **versions}, "seed": seed, "inputs": hashes}


def _sha256(path: Path) -> str:
    """SHA-256 of a file."""
    try:
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None


def _version(name: str) -> str | None:
    """Version of an installed distribution."""
    try:
        return version(name)
    except PackageNotFoundError:
        return None


# ---- folders


def check_out(out: Path, force: bool) -> None:
    """Stop before anything is computed if the results could not be written to ``out``.

    Args:
        out: The folder for the results; it need not exist.
        force: Replace results in a folder that is not empty.

    Raises:
        InputError: ``out`` is a file or a link, cannot be written, or is not empty and ``force`` is off.
    """
    if out.is_symlink():
        raise InputError(f"--out {out}: is a symbolic link; name the folder itself")
    if out.exists() and not out.is_dir():
        raise InputError(f"--out {out}: is a file; a folder expected")
    place = _nearest_folder(out)
    if not place.is_dir() or not os.access(place, os.W_OK | os.X_OK):
        raise InputError(f"--out {out}: {place} is no folder that can be written")
    if not out.is_dir():
        return
    recover(out)
    entries = sorted(entry.name for entry in out.iterdir() if not entry.name.startswith(_OPEN))
    if entries and not force:
        shown = ", ".join(entries[:3]) + (", ..." if len(entries) > 3 else "")
        raise InputError(f"--out {out}: the folder is not empty ({shown}); choose another one or give --force")


def _nearest_folder(path: Path) -> Path:
    """The path itself, or the nearest parent that exists."""
    path = path.absolute()
    while not path.exists() and path != path.parent:
        path = path.parent
    return path


def write_results(
    out: Path, files: Mapping[str, str | bytes], *, force: bool = False, obsolete: Collection[str] = ()
) -> None:
    """Write all files of one result, or none (see the head of this module).

    Args:
        out: The folder; it is made if it does not exist.
        files: Content by file name.
        force: Replace results in a folder that is not empty.
        obsolete: Names that earlier runs of the same command may have left; they go unless written anew.

    Raises:
        InputError: The folder cannot be used (`check_out`), or a name of ``files`` is taken by a folder.
    """
    for name in [*files, *obsolete]:
        if not name or Path(name).name != name or name.startswith("."):
            raise InputError(f"result file {name!r}: a plain file name expected")
    check_out(out, force)
    for name in files:
        if (out / name).is_dir() and not (out / name).is_symlink():
            raise InputError(f"{out / name}: is a folder; a result of this name cannot be written")
    out = out.absolute()
    names = {*files, *obsolete}
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        if not _whole_folder(out, names) or not _write_folder(out, files, names):
            _write_into(out, files, names)
    except OSError as error:
        raise InputError(f"--out {out}: results cannot be written: {error.strerror}") from error


def recover(out: Path) -> None:
    """Finish a result whose writing into a folder with other files was cut short after it was complete.

    Call it before reading results of a folder; it does nothing otherwise.
    """
    for leftover in out.glob(f"{_OPEN}new-*"):
        _discard(leftover)
    sealed = out / _SEALED
    if sealed.is_dir() and not sealed.is_symlink():
        _log.warning("%s: finishing a result whose writing was interrupted", out)
        _unpack(sealed, out)


def _whole_folder(out: Path, names: Collection[str]) -> bool:
    """True if the folder can be replaced as a whole: nothing else is in it, and we do not stand in it."""
    if not out.exists():
        return True
    here = Path.cwd()
    if out.resolve() in {here, *here.parents} or out.is_mount():
        return False
    return all(entry.name in names and (entry.is_file() or entry.is_symlink()) for entry in out.iterdir())


def _write_folder(out: Path, files: Mapping[str, str | bytes], names: Collection[str]) -> bool:
    """Put a complete new folder in place of a missing, empty or old one; False if the system cannot."""
    staged = Path(tempfile.mkdtemp(prefix=f"{_OPEN}{out.name}-", dir=out.parent))
    swapped = False
    try:
        _fill(staged, files)
        staged.chmod(out.stat().st_mode & 0o7777 if out.exists() else 0o777 & ~_umask())
        if not out.exists() or not any(out.iterdir()):
            staged.replace(out)
            return True
        swapped = _exchange(staged, out)
    except OSError:  # not every file system renames folders like this
        return False
    finally:
        if not swapped:
            _discard(staged)
    if swapped:
        _retire(staged, out, names)
    return swapped


def _retire(old: Path, out: Path, names: Collection[str]) -> None:
    """Remove the old result; a file that came into its folder at the last moment is not ours and moves along."""
    with contextlib.suppress(OSError):
        for entry in sorted(old.iterdir()):
            if entry.name in names:
                entry.unlink()
            elif not (out / entry.name).exists():
                entry.rename(out / entry.name)
        old.rmdir()


def _write_into(out: Path, files: Mapping[str, str | bytes], names: Collection[str]) -> None:
    """Replace files of a folder that holds others too."""
    out.mkdir(exist_ok=True)
    staged = Path(tempfile.mkdtemp(prefix=f"{_OPEN}new-", dir=out))
    try:
        _fill(staged, {_REMOVE: "\n".join(sorted(set(names) - files.keys())), **files})
        staged.rename(out / _SEALED)  # from here on the new result will be finished, whatever happens
    finally:
        _discard(staged)
    _unpack(out / _SEALED, out)


def _unpack(sealed: Path, out: Path) -> None:
    """Move a sealed result over the old one, JSON last; can be repeated until it is done."""
    entries = [entry for entry in sealed.iterdir() if entry.name != _REMOVE]
    for entry in sorted(entries, key=lambda entry: (entry.suffix == ".json", entry.name)):
        entry.replace(out / entry.name)
    remove = sealed / _REMOVE
    if remove.exists():
        for name in remove.read_text(encoding="utf-8").split("\n"):
            if name and Path(name).name == name and ((out / name).is_file() or (out / name).is_symlink()):
                (out / name).unlink()
    _discard(sealed)


def _fill(folder: Path, files: Mapping[str, str | bytes]) -> None:
    """Write files and wait until they are on the disk."""
    for name, content in files.items():
        with (folder / name).open("wb") as stream:
            stream.write(content.encode("utf-8") if isinstance(content, str) else content)
            stream.flush()
            os.fsync(stream.fileno())


def _discard(folder: Path) -> None:
    """Remove a folder of ours, whatever is left of it."""
    if folder.is_dir() and not folder.is_symlink() and folder.name.startswith(_OPEN):
        shutil.rmtree(folder, ignore_errors=True)


def _umask() -> int:
    """The mask of new files."""
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _exchange(staged: Path, out: Path) -> bool:
    """Let two folders change names in one step; False where the system cannot."""
    old, new = os.fsencode(staged), os.fsencode(out)
    try:
        libc = ctypes.CDLL(None, use_errno=True)
        if sys.platform == "linux":
            at_cwd, swap = -100, 2  # AT_FDCWD, RENAME_EXCHANGE
            return bool(libc.renameat2(at_cwd, old, at_cwd, new, swap) == 0)
        if sys.platform == "darwin":
            return bool(libc.renamex_np(old, new, 2) == 0)  # RENAME_SWAP
    except (OSError, AttributeError, TypeError):
        pass
    return False
