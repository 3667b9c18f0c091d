"""Why a gateway ended, for ``pdgw status`` and the page: a file in the run directory for each status port.

A start deletes it, so it belongs to the newest gateway of this port. A gateway that is killed leaves none.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

from pdgw.errors import PdgwError
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.trace.place import prepared, run_directories, run_directory


def _name(port: int) -> str:
    return f"ended-{port}.json"


@contextlib.contextmanager
def kept_last_words(port: int) -> Iterator[None]:
    """Keep how the gateway with this status port ends. 0: it has none. Without a run directory nothing is kept."""
    file = _file(port)
    if file is None:
        yield
        return
    with contextlib.suppress(OSError):
        file.unlink(missing_ok=True)
    text = "stopped as commanded"
    try:
        yield
    except BaseException as error:
        text = str(error) if isinstance(error, PdgwError) else f"unexpected error: {error!r}"
        raise
    finally:
        document = {"time": datetime.now().astimezone().isoformat(timespec="seconds"), "text": text}
        with contextlib.suppress(OSError):
            file.write_text(json.dumps(document), encoding="utf-8")


def _file(port: int) -> Path | None:
    directory = run_directory()
    if not port or directory is None:
        return None
    try:
        return prepared(directory) / _name(port)
    except GatewayError:
        return None


def last_words(port: int) -> str:
    """When and why the last gateway with this status port ended; empty if that is unknown."""
    found = []
    for directory in run_directories():
        with contextlib.suppress(
            OSError, ValueError, KeyError, TypeError
        ):  # it belongs to another user, or is half written
            document = json.loads((directory / _name(port)).read_text(encoding="utf-8"))
            found.append((datetime.fromisoformat(document["time"]), str(document["text"])))
    if not found:
        return ""
    time, text = max(found)
    return f"the last one ended on {time:%Y-%m-%d at %H:%M:%S}: {text}"
