"""`companion monitor` as a process, and its interface."""

from __future__ import annotations

import http.client
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager


@contextmanager
def monitor(*arguments: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The process and the line that it printed."""
    process = subprocess.Popen(
        [sys.executable, "-m", "companion", "monitor", "--listen", "127.0.0.1:0", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout
    try:
        yield process, process.stdout.readline().strip()
    finally:
        process.kill()
        process.communicate()


def get(url: str, path: str, method: str = "GET", body: str = "", **headers: str) -> tuple[int, str]:
    found = re.match(r"http://([\d.]+):(\d+)/", url)
    assert found, url
    with closing(http.client.HTTPConnection(found[1], int(found[2]), timeout=20)) as connection:
        connection.request(method, path, body, headers)
        answer = connection.getresponse()
        return answer.status, answer.read().decode()


def snapshot(url: str) -> dict[str, list[dict[str, object]]]:
    decoded: dict[str, list[dict[str, object]]] = json.loads(get(url, "/api/v1/snapshot")[1])
    return decoded
