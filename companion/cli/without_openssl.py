"""Keeps OpenSSL out of an agent's memory, 5 MB of it.

Of the standard library `asyncio` imports it for TLS and `hashlib` for hashes. Both are made to do without: `asyncio` then has
no TLS, which no agent uses (Zenoh and `cryptography` carry their own), and `hashlib` takes the interpreter's own algorithms.
"""

from __future__ import annotations

import sys
from importlib.util import find_spec

BUILT_IN_SHA256 = ("_sha256", "_sha2")  # until Python 3.11, and since


def leave_out_openssl() -> None:
    """Makes `import ssl` and `import _hashlib` fail from now on, as on a system without OpenSSL.

    To be called before `asyncio` or `hashlib` is imported. An interpreter without algorithms of its own keeps those of OpenSSL.
    """
    left_out = ["ssl", "_ssl"]
    if any(map(find_spec, BUILT_IN_SHA256)) and find_spec("_blake2"):
        left_out.append("_hashlib")
    for name in left_out:
        sys.modules.setdefault(name, None)  # type: ignore[arg-type]  # documented: an import of it then fails
