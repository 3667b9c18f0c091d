"""Why a gateway ended, and what had stopped its drive objects: a file in the run directory for each status port.

For ``pdgw status``, the page and the next gateway of this port. A start replaces it, so it belongs to the newest gateway of this
port. That of a gateway that was killed has no end, but its process, its last sign of life and its last event.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Callable, Iterator
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pdgw.base.durations import SECOND
from pdgw.base.errors import PdgwError
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.run_directory import prepared, run_directories, run_directory

if TYPE_CHECKING:  # the command line reads the last words without a loop
    from pdgw.ds301.loop.loop import Loop

_ALIVE_NS: Final = 5 * SECOND
"""Time between two signs of life."""


def _name(port: int) -> str:
    return f"ended-{port}.json"


class LastWords:
    """What the last gateway with a status port has left, and what this one leaves."""

    def __init__(self, port: int) -> None:
        document = _newest(port)
        self.text = _text(document | {"event": ""}, os.getpid()) if document else ""
        """How the last one ended, without its last event: ``origins`` have what counts. Empty if that is unknown."""
        self.origins: dict[str, str] = document.get("origins", {})
        """What had stopped its drive objects, by DO-ID."""
        self.find: Callable[[], dict[str, str]] = lambda: self.origins
        """The same of this one."""
        self._file = _file(port)

    def keep(self, loop: Loop, find: Callable[[], dict[str, str]], event: Callable[[], str] = str) -> None:
        """Write what stops the drive objects and the last ``event`` within a second of a change, and a sign of life every 5 s:
        who is killed has no later time for it.
        """
        self.find = find

        def look(before: tuple[dict[str, str], str] | None = None, written: int = 0) -> None:
            found, now = (find(), event()), loop.now()
            if found != before or now - written >= _ALIVE_NS:
                written = now
                loop.offload(lambda: self.write("", *found))
            loop.call_later(SECOND, lambda: look(found, written))

        look()

    def write(self, text: str, origins: dict[str, str], event: str = "") -> None:
        """``text``: how this gateway has ended, empty while it runs. A file that cannot be written is left out."""
        if self._file is None:
            return
        document = {
            "time": datetime.now().astimezone().isoformat(timespec="seconds"),
            "text": text,
            "origins": origins,
            "process": os.getpid(),
            "event": event,
        }
        temporary = self._file.with_suffix(".new")
        with contextlib.suppress(OSError):
            temporary.write_text(json.dumps(document), encoding="utf-8")
            temporary.replace(self._file)


@contextlib.contextmanager
def kept_last_words(port: int) -> Iterator[LastWords]:
    """Keep how the gateway with this status port ends. 0: it has none. Without a run directory nothing is kept."""
    words = LastWords(port)
    words.write("", words.origins)
    text = "stopped as commanded"
    try:
        yield words
    except BaseException as error:
        text = str(error) if isinstance(error, PdgwError) else f"unexpected error: {error!r}"
        raise
    finally:
        words.write(text, words.find())


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


def _text(document: dict[str, Any], starting: int = 0) -> str:
    """``starting``: the process of the next gateway of the same port, which may have the number of the last one."""
    if not document:
        return ""
    time = datetime.fromisoformat(document["time"])
    if document["text"]:
        return f"the last one ended on {time:%Y-%m-%d at %H:%M:%S}: {document['text']}"
    process, event = document.get("process", 0), document.get("event", "")
    if not process or (process != starting and _runs(process)):
        return ""
    last = f"the last one was killed or has crashed, its last sign of life was on {time:%Y-%m-%d at %H:%M:%S}"
    return f"{last}; its last event: {event}" if event else last


def _runs(process: int) -> bool:
    """Whether a process exists; True where that cannot be found out."""
    if os.name != "posix":
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        pass  # it belongs to another user
    return True
