"""A Python file that a configuration file names: code that runs in the agent, so it is read with more care than a value.

It must be in the folder of the file that names it, and neither may be writable by anyone but the user of this process and root:
who can write one of them could already change the configuration, and nobody else gains anything. Both are opened once, and what
was checked is what runs. The code imports what is installed and no file beside it, so its SHA-256 stands for all of it.
"""

from __future__ import annotations

import ast
import errno
import os
import stat
import sys
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from traceback import walk_tb
from types import ModuleType
from typing import Any

from companion.config.file import ConfigError, read_descriptor
from companion.types.errors import CompanionError
from companion.types.values import cut, quoted

WRITABLE_BY_OTHERS = stat.S_IWGRP | stat.S_IWOTH
LONGEST_ERROR = 200
CODE = "companion_code_"  # begin of the names of modules that are loaded here; the same content may be in several files
DOES_MORE = {
    *("asyncio", "builtins", "concurrent", "ctypes", "datetime", "ftplib", "http", "importlib", "io", "logging"),
    *("mmap", "multiprocessing", "os", "pathlib", "pickle", "queue", "random", "requests", "secrets", "select"),
    *("serial", "shutil", "signal", "smtplib", "socket", "socketserver", "ssl", "subprocess", "sys", "tempfile"),
    *("threading", "time", "urllib", "uuid", "numpy.random", "mavsdk", "pymavlink", "zenoh"),
    *("companion.app", "companion.ground", "companion.link"),
}
CALLS_MORE = {"__import__", "breakpoint", "compile", "eval", "exec", "globals", "input", "open", "print"}


@dataclass(frozen=True, slots=True)
class CodeFile:
    """The names that the file defines, and the SHA-256 of its content, hexadecimal."""

    namespace: Mapping[str, Any]
    sha256: str


LOADED: dict[str, CodeFile] = {}  # by SHA-256: what has passed the checks of a file of this machine


class UnreadCodeError(ConfigError):
    """Code that a configuration names and nothing has brought, as of a recording. `sha256` is empty where none is known."""

    def __init__(self, file: str, sha256: str) -> None:
        wanted = f" with the SHA-256 {sha256}" if sha256 else ""
        expected = "expected the file of a fleet file, a vehicle file or a scenario beside it, or of --code"
        super().__init__(file, "", f"is code{wanted} that has not been read; {expected}")
        self.file, self.sha256 = file, sha256


def load_code(path: Path, beside: Path) -> CodeFile:
    """Run a Python file once. `beside` is the configuration file that names it; a relative path starts there.

    Raises ConfigError where the file must not be run, and where it does not run.
    """
    file = beside.parent / path
    source = read_beside(path, beside)
    from hashlib import sha256  # here: see `formation_hash` in fleet.py

    digest = sha256(source).hexdigest()
    if digest in LOADED:
        return LOADED[digest]
    if (found := more_than_computing(source, file)) is not None:
        raise found
    module = ModuleType(f"{CODE}{digest}")
    module.__file__ = str(file)
    sys.modules[module.__name__] = module  # where dataclasses and pickle look for what it defines
    try:
        exec(compile(source, str(file), "exec", dont_inherit=True), module.__dict__)
    except (Exception, SystemExit) as error:
        del sys.modules[module.__name__]
        raise code_error(file, error) from error
    return LOADED.setdefault(digest, CodeFile(module.__dict__, digest))


def loaded_code(file: str, sha256: str | None) -> CodeFile:
    """The code with this content, which has been loaded. Raises UnreadCodeError: a recording or a command brings no code."""
    code = LOADED.get(sha256 or "")
    if code is None:
        raise UnreadCodeError(file, sha256 or "")
    return code


def is_loaded(sha256: object) -> bool:
    """Whether the code with this content has been loaded."""
    return sha256 in LOADED


def read_section(section: dict[str, Any], where: str, beside: Path) -> dict[str, Any]:
    """A plain section with the whole path and the SHA-256 of the `file` that it names, which is loaded. Raises ConfigError."""
    name, wanted = section.get("file"), section.get("sha256")
    if not isinstance(name, str) or (Path(name).is_absolute() and is_loaded(wanted)):  # or read already
        return section
    code = load_code(Path(name), beside)
    if wanted not in (None, code.sha256):
        raise ConfigError(beside, f"{where}.sha256", f"{name} has {code.sha256}, which is another one")
    return section | {"file": str((beside.parent / name).resolve()), "sha256": code.sha256}


def carried_section(section: dict[str, Any], folder: Path) -> dict[str, Any]:
    """A plain section with a copy of its file in the folder; others may write neither, whatever the umask."""
    if section.get("file") is None:
        return section
    source = Path(section["file"])
    copy = folder / source.name
    if source.parent.resolve() != folder.resolve():
        copy.write_bytes(source.read_bytes())
        for path in (copy, folder):
            path.chmod(path.stat().st_mode & ~WRITABLE_BY_OTHERS)
    return section | {"file": source.name}


def more_than_computing(source: bytes, file: Path) -> ConfigError | None:
    """The line for the first import, call or statement of this code that does more than compute, or for a syntax error."""
    try:
        tree = ast.parse(source, str(file))
    except (SyntaxError, ValueError) as error:
        return code_error(file, error)
    for node in ast.walk(tree):
        modules: list[str] = []
        if isinstance(node, ast.Import):
            modules = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            modules = [node.module or "", *(f"{node.module}.{alias.name}" for alias in node.names)]
        refused = [
            f"imports {name}" for name in modules if DOES_MORE & {name.split(".")[0], ".".join(name.split(".")[:2])}
        ]
        if isinstance(node, ast.Name) and node.id in CALLS_MORE:
            refused = [f"uses {node.id}"]
        elif isinstance(node, ast.Global):
            refused = [f"changes {', '.join(node.names)} outside its function"]
        if refused:
            text = f"{refused[0]}; expected code that computes from its arguments alone, as it runs in the control loop"
            return ConfigError(file, f"line {getattr(node, 'lineno', 1)}", text)
    return None


def read_beside(path: Path, beside: Path) -> bytes:
    """The content of a file in the folder of the file `beside`, after all checks of both. Raises ConfigError."""
    folder, file = beside.parent, beside.parent / path
    with suppress(OSError, RuntimeError, ValueError):  # what is wrong with the path shows when it is opened
        if file.parent.resolve() != folder.resolve():
            raise ConfigError(beside, "", f"names {quoted(str(path))}; expected a file in its own folder, {folder}")
    try:
        inside = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            _refuse_foreign(folder, os.fstat(inside))
            descriptor = os.open(path.name, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW | os.O_CLOEXEC, dir_fd=inside)
            try:
                content, state = read_descriptor(descriptor)
            finally:
                os.close(descriptor)
        finally:
            os.close(inside)
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the path
        reason = error.strerror if isinstance(error, OSError) else "a zero byte in its name"
        is_link = isinstance(error, OSError) and error.errno == errno.ELOOP
        remedy = "expected the file itself, not a symbolic link" if is_link else "check the path"
        raise ConfigError(file, "", f"cannot be read: {reason}; {remedy}") from error
    _refuse_foreign(file, state)
    return content


def code_error(file: Path, error: BaseException) -> ConfigError:
    """The line for an exception that this file has raised; it names the line of the file."""
    return ConfigError(file, "", raised_in_words(error))


def raised_in_words(error: BaseException) -> str:
    """ "line 41: TypeError: ..." for an exception that the code of a file has raised; of other code without the line."""
    said = str(error)
    if isinstance(error, SyntaxError):
        line, said = error.lineno, error.msg  # str() has file and line again
    else:
        frames = walk_tb(error.__traceback__)
        lines = [line for frame, line in frames if str(frame.f_globals.get("__name__")).startswith(CODE)]
        line = lines[-1] if lines else None
    name = "" if isinstance(error, CompanionError) else f"{type(error).__name__}: "
    text = cut(f"{name}{' '.join(said.split())}".removesuffix(": "), LONGEST_ERROR)
    return f"line {line}: {text}" if line else text


def _refuse_foreign(path: Path, state: os.stat_result) -> None:
    """Raises ConfigError for a file or folder that another user could change."""
    if state.st_uid not in (os.geteuid(), 0):
        expected = f"that of this process ({os.geteuid()}) or root"
        raise ConfigError(path, "", f"belongs to user {state.st_uid}; expected {expected}, as its code is run")
    if state.st_mode & stat.S_ISVTX and stat.S_ISDIR(state.st_mode):  # like /tmp, where everybody has files
        raise ConfigError(path, "", "everybody may write files there, and its code is run; use a folder of your own")
    if state.st_mode & WRITABLE_BY_OTHERS:
        mode = f"mode {stat.S_IMODE(state.st_mode):o}"
        raise ConfigError(path, "", f"others may write it ({mode}) and its code is run; chmod go-w {path}")
