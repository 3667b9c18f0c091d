"""Run the ``console`` blocks of a Markdown file, command by command, as a reader types them.

In such a block, a line that begins with ``$`` is a command for bash. The lines below it are its output (``...`` matches any text;
spaces and line ends count as one space). The command must succeed unless the output contains ``error:``. A command that ends in
``&`` runs beside the others; the tour waits for its output. ``$ kill %1`` ends the first of these as Ctrl-C does, and the lines
below it are the rest of its output. A block ``toml``, ``yaml`` or ``python`` whose first line is ``# NAME`` is a file the reader
writes.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from doctest import ELLIPSIS, NORMALIZE_WHITESPACE, OutputChecker
from pathlib import Path

PATIENCE_S = 120.0
"""Longest time of a command in a document, also on a busy machine."""

_BLOCK = re.compile(
    r"^(?P<indent> *)```(?P<kind>console|toml|yaml|python)\n(?P<body>.*?)^ *```$", re.MULTILINE | re.DOTALL
)
_FILE = re.compile(r"# (?P<name>[\w.-]+\.(?:toml|yaml|py))\n")
_KILL = re.compile(r"kill %(\d+)")


@dataclass(frozen=True, slots=True)
class Command:
    """One ``$`` line with what the document shows below it."""

    text: str
    output: str


@dataclass(frozen=True, slots=True)
class File:
    """A file that the reader writes."""

    name: str
    text: str


def steps(document: str) -> Iterator[Command | File]:
    """The commands and files of a document, in order."""
    for block in _BLOCK.finditer(document):
        body = "".join(line.removeprefix(block["indent"]) for line in block["body"].splitlines(keepends=True))
        if block["kind"] == "console":
            for part in re.split(r"^\$ ", body, flags=re.MULTILINE)[1:]:
                text, _, output = part.partition("\n")
                yield Command(text.split("  #")[0].strip(), output)
        elif (named := _FILE.match(body)) is not None:
            yield File(named["name"], body)


def agrees(shown: str, printed: str) -> bool:
    """Whether a command printed what the document shows; a document that shows nothing claims nothing."""
    shown = re.sub(r"(\s*\.\.\.\s*)+", "...", shown)
    return not shown.strip() or OutputChecker().check_output(shown, printed, ELLIPSIS | NORMALIZE_WHITESPACE)


class Background:
    """A command in the background; its output is collected."""

    def __init__(self, text: str, folder: Path) -> None:
        self.text = text
        self.printed = ""
        self._grown = threading.Condition()
        self._process = subprocess.Popen(
            ["bash", "-c", f"exec {text}"], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            with self._grown:
                self.printed += line
                self._grown.notify_all()

    def wait_for(self, shown: str) -> None:
        """Until it has printed what the document shows. Raises AssertionError."""
        with self._grown:
            seen = self._grown.wait_for(lambda: agrees(shown + "...\n", self.printed), PATIENCE_S)
        assert seen, f"$ {self.text}\nshould have printed\n{shown}\nbut printed\n{self.printed}"

    def end(self) -> str:
        """Send Ctrl-C. Return the further output. A command that does not end is an error."""
        before = len(self.printed)
        self._process.send_signal(signal.SIGINT)
        self._process.wait(PATIENCE_S)
        self._reader.join(PATIENCE_S)
        return self.printed[before:]

    def abandon(self) -> None:
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()


@dataclass(slots=True)
class Terminal:
    """Runs a document: a folder and the background commands in it."""

    folder: Path
    running: list[Background] = field(default_factory=list)

    def run_document(self, document: str) -> int:
        """All steps; returns how many commands there were. Raises AssertionError at the first that differs."""
        count = 0
        try:
            for step in steps(document):
                if isinstance(step, File):
                    (self.folder / step.name).write_text(step.text)
                else:
                    self._command(step)
                    count += 1
        finally:
            for background in self.running:
                background.abandon()
        return count

    def _command(self, step: Command) -> None:
        print(f"$ {step.text}", flush=True)
        if (kill := _KILL.fullmatch(step.text)) is not None:
            printed = self.running[int(kill[1]) - 1].end()
        elif step.text.endswith("&"):
            self.running.append(Background(step.text.removesuffix("&").strip(), self.folder))
            self.running[-1].wait_for(step.output)
            return
        else:
            done = subprocess.run(
                ["bash", "-c", step.text],
                check=False,
                cwd=self.folder,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                timeout=PATIENCE_S,
            )
            printed = done.stdout
            wrong = done.returncode != 0 and "error: " not in step.output
            assert not wrong, f"$ {step.text}\nends with exit status {done.returncode}:\n{printed}"
        assert agrees(step.output, printed), f"$ {step.text}\nshould print\n{step.output}\nbut printed\n{printed}"


if __name__ == "__main__":
    # In a network namespace of its own: the ports of the documents are free there, whatever else runs on the machine.
    subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
    target = Path(sys.argv[1])
    os.environ["PATH"] = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    try:
        print(f"{Terminal(Path(sys.argv[2])).run_document(target.read_text())} commands")
    except AssertionError as difference:
        raise SystemExit(f"{target.name}: {difference}") from None
