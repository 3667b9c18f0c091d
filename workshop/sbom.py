"""The software bill of materials of a release: CycloneDX 1.6, JSON. Source: https://cyclonedx.org/docs/1.6/json/.

Components are the product's run-time dependencies with those of some extras, in the installed versions (constraints.txt), and the
files of others that the page consists of. The same input gives the same bytes.
"""

from __future__ import annotations

import json
import uuid
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import requires, version
from typing import Any

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from pdgw.web.support import PACKAGE, VENDORED, licence

EXTRAS = ("mqtt", "plot", "web")
"""Their packages are installed wherever a release is made."""
Document = dict[str, Any]


def needed(name: str, extras: Sequence[str] = ()) -> list[str]:
    """The packages that a package needs on this platform with these extras, by their normal names."""
    found = set()
    for text in requires(name) or ():
        item = Requirement(text)
        if item.marker is None or any(item.marker.evaluate({"extra": extra}) for extra in ("", *extras)):
            found.add(canonicalize_name(item.name))
    return sorted(found)


def closure(name: str, extras: Sequence[str] = ()) -> dict[str, list[str]]:
    """What each package needs, for a package and everything below it."""
    found = {name: needed(name, extras)}
    waiting = list(found[name])
    while waiting:
        item = waiting.pop()
        if item not in found:
            found[item] = needed(item)
            waiting += found[item]
    return found


def document(release: str, epoch: int) -> Document:
    """The bill of materials of version ``release``; ``epoch``: seconds since 1970."""
    below = closure(PACKAGE, EXTRAS)
    required = closure(PACKAGE)
    components = [
        _component(f"pkg:pypi/{name}@{version(name)}", name, version(name), licence(name).get("licence", ""))
        | {"scope": "required" if name in required else "optional"}
        for name in sorted(below)
        if name != PACKAGE
    ]
    for item in json.loads(VENDORED.read_text(encoding="utf-8")):
        files = [
            {"type": "file", "name": file["file"], "hashes": [{"alg": "SHA-256", "content": file["sha256"]}]}
            for file in item["files"]
        ]
        purl = f"pkg:npm/{item['package']}@{item['version']}"
        made = _component(purl, item["package"], item["version"], item["licence"])
        components.append(made | {"scope": "required", "components": files})
    names = {name: f"pkg:pypi/{name}@{release if name == PACKAGE else version(name)}" for name in below}
    product = _component(names[PACKAGE], PACKAGE, release, licence(PACKAGE).get("licence", ""))
    vendored = [item["bom-ref"] for item in components if item["bom-ref"].startswith("pkg:npm/")]
    dependencies = [
        {
            "ref": names[name],
            "dependsOn": [*(names[item] for item in items), *(vendored if name == PACKAGE else ())],
        }
        for name, items in sorted(below.items())
    ]
    content = {"components": components, "dependencies": dependencies}
    return {
        "$schema": "http://cyclonedx.org/schema/bom-1.6.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "serialNumber": f"urn:uuid:{uuid.uuid5(uuid.NAMESPACE_URL, json.dumps([names[PACKAGE], epoch, content]))}",
        "version": 1,
        "metadata": {"timestamp": datetime.fromtimestamp(epoch, UTC).isoformat(), "component": product},
        **content,
    }


def _component(purl: str, name: str, release: str, given: str) -> Document:
    made: Document = {"type": "library", "bom-ref": purl, "name": name, "version": release, "purl": purl}
    return made | ({"licenses": [{"license": {"name": given}}]} if given else {})
