"""Why a gateway ended, and what had stopped its drive objects: a file in the run directory for each status port.

For ``pdgw status``, the page and the next gateway of this port. A start deletes it, so it belongs to the newest gateway of this
port. A gateway that is killed leaves none.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

from pdgw.errors import PdgwError
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.trace.place import prepared, run_directories, run_directory


def _name(port: int) -> str:
    return f"ended-{port}.json"


class LastWords:
    """What the last gateway with a status port has left, and what this one leaves."""

    def __init__(self, port: int) -> None:
        document = _newest(port)
        self.text = _text(document)
        """How the last one ended; empty if that is unknown."""
        self.origins: dict[str, str] = document.get("origins", {})
        """What had stopped its drive objects, by DO-ID."""
        self.kept: Callable[[], dict[str, str]] = dict
        """The same of this one, at its end."""


@contextlib.contextmanager
def kept_last_words(port: int) -> Iterator[LastWords]:
    """Keep how the gateway with this status port ends. 0: it has none. Without a run directory nothing is kept."""
    words, file = LastWords(port), _file(port)
    if file is None:
        yield words
        return
    with contextlib.suppress(OSError):
        file.unlink(missing_ok=True)
    text = "stopped as commanded"
    try:
        yield words
    except BaseException as error:
        text = str(error) if isinstance(error, PdgwError) else f"unexpected error: {error!r}"
        raise
    finally:
        time = datetime.now().astimezone().isoformat(timespec="seconds")
        document = {"time": time, "text": text, "origins": words.kept()}
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
    return _text(_newest(port))


def _newest(port: int) -> dict[str, Any]:
    """The newest document of this status port; empty without one."""
    found = []
    for directory in run_directories():
        with contextlib.suppress(
            OSError, ValueError, KeyError, TypeError
        ):  # it belongs to another user, or is half written
            document = json.loads((directory / _name(port)).read_text(encoding="utf-8"))
            found.append((datetime.fromisoformat(document["time"]), document | {"text": str(document["text"])}))
    return max(found, key=lambda item: item[0], default=(None, {}))[1]


def _text(document: dict[str, Any]) -> str:
    if not document:
        return ""
    time = datetime.fromisoformat(document["time"])
    return f"the last one ended on {time:%Y-%m-%d at %H:%M:%S}: {document['text']}"
