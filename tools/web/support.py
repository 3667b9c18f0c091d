"""The page's information about the gateway, its support file, and errors of a request: 400 or 404, with the field."""

from __future__ import annotations

import io
import json
import re
import zipfile
from collections.abc import Callable
from dataclasses import asdict
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, metadata, requires
from pathlib import Path
from typing import Any

from pdgw.base.version import package_version
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.file import public_config
from pdgw.tools.web.status.watch import Watch


class RequestError(GatewayError):
    """The request is wrong in ``field``: a path parameter, a parameter of the query, or a header."""

    def __init__(self, field: str, text: str, status: int = 400) -> None:
        super().__init__(text)
        self.field = field
        self.status = status


VENDORED = Path(__file__).parent / "static" / "vendor" / "vendored.json"
_CAPTURE_S = 30
PACKAGE = "profidrive-gateway"
RUN_TIME_EXTRAS = {"web", "mqtt", "plot", "parquet"}
"""Extras that the gateway and its commands import; the others serve development, tests and examples."""


@lru_cache(maxsize=1)
def licences() -> list[dict[str, str]]:
    """Return every package that the gateway can use at run time, and the files of others on the page."""
    found = {PACKAGE: licence(PACKAGE)}
    for requirement in requires(PACKAGE) or ():
        extra = re.search(r"extra == ['\"](\w+)['\"]", requirement)
        if extra and extra[1] not in RUN_TIME_EXTRAS:
            continue
        name = re.split(r"[^\w.-]", requirement, maxsplit=1)[0]
        if name not in found:
            found[name] = licence(name)
    listed = [{"name": name, **known} for name, known in found.items() if known]
    vendored = json.loads(VENDORED.read_text(encoding="utf-8"))
    return listed + [
        {"name": item["package"], "version": item["version"], "licence": item["licence"]} for item in vendored
    ]


def licence(name: str) -> dict[str, str]:
    """Version and licence of an installed package; empty for one that is not installed."""
    try:
        said = metadata(name)
    except PackageNotFoundError:
        return {}  # the extra is not installed
    listed = [text.rpartition(" :: ")[2] for text in said.get_all("Classifier") or () if text.startswith("License")]
    given = next((str(said[key]).partition("\n")[0] for key in ("License-Expression", "License") if key in said), "")
    return {"version": said["Version"], "licence": given or ", ".join(listed) or "see its files"}


def about_document(config: GatewayConfig) -> dict[str, Any]:
    """Contents of the view About."""
    return {"version": package_version(), "configuration": public_config(config), "licences": licences()}


def support_archive(watch: Watch, capture: Callable[[float], bytes]) -> bytes:
    """A ZIP file: newest status, events, configuration without secrets, the last half minute of both buses if recorded."""
    status = watch.feed.status()
    files = {
        "status.json": json.dumps(status, indent=1),
        "events.json": json.dumps([asdict(event) for event in watch.log.after(0)], indent=1),
        "gateway.toml": public_config(watch.config),
    }
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in files.items():
            archive.writestr(name, text)
        try:
            archive.writestr("capture.pcapng", capture(_CAPTURE_S))
        except GatewayError as error:
            archive.writestr("capture.txt", f"No capture is included: {error}\n")
    return made.getvalue()
