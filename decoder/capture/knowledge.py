"""Facts for the decoder before a capture: from the user, and from the start of the capture."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Final

from pdgw.decoder.capture.axes import configured_axes
from pdgw.decoder.capture.dictionary import dictionary_of
from pdgw.decoder.capture.errors import CaptureError
from pdgw.decoder.capture.source import open_source
from pdgw.decoder.frames.canopen.objects import ObjectNames
from pdgw.decoder.frames.engine import Axis, Decoder, Settings, given_axes
from pdgw.decoder.frames.records import CyclicRecord
from pdgw.decoder.view.names import Names
from pdgw.ds301.connection_set import NODE_IDS
from pdgw.gateway.errors import GatewayError

_LOOK_AT: Final = 20_000
"""Number of packets searched for telegrams and the first cyclic frame."""
_LOOK_AT_CAN: Final = 2_000
"""Number of packets that are enough without any cyclic frame."""
_NODE_FILE = re.compile(r"(\d{1,3})=(.+)")


@dataclass(frozen=True)
class Knowledge:
    """The user's settings: those of the decoder, every known name, the bit rate of the first bus."""

    settings: Settings
    names: Names
    bitrate: int | None = None


def known_beforehand(
    telegrams: Sequence[int],
    config: Path | None,
    eds: Sequence[str],
    station: str = "",
    embedded: str = "",
) -> Knowledge:
    """From ``--telegram``, ``--config``, ``--eds`` and ``--station``; GatewayError or ProfidriveError for what cannot
    be used.
    ``embedded``: the text of a configuration the capture has in it, used without ``config``.
    """
    axes: Sequence[Axis] = given_axes(telegrams)
    origin = "--telegram, with the axis number as node-ID"
    files, default = _eds_files(eds)
    settings = Settings()
    cyclic, acyclic = settings.cyclic_ports, settings.acyclic_ports
    bitrate = None
    if config is not None or embedded:
        from pdgw.gateway.configuration.file import load_config, parse_config  # noqa: PLC0415 (loads the whole gateway)

        loaded = (
            load_config(config) if config is not None else parse_config(embedded, "the configuration in the capture")
        )
        origin = "configuration"
        axes = configured_axes(loaded, telegrams)
        files = {axis.node_id: axis.eds for axis in loaded.axis if axis.eds and axis.eds.is_file()} | files
        cyclic |= {loaded.transport.cyclic_port}
        acyclic |= {loaded.transport.acyclic_port}
        bitrate = loaded.can[0].bitrate
    dictionary = dictionary_of(files, default) if files or default else None
    names = Names()
    if dictionary is not None:
        # Names do not depend on the node-ID, so one is enough. Report unusable files before the first packet.
        chosen = [*files, *([min(set(range(1, 128)) - set(files))] if default else [])]
        names = Names(ObjectNames(found) for node_id in chosen if (found := dictionary(node_id)) is not None)
    return Knowledge(
        Settings(axes, origin, dictionary, frozenset(cyclic - {0}), frozenset(acyclic - {0}), station), names, bitrate
    )


def _eds_files(texts: Sequence[str]) -> tuple[dict[int, Path], Path | None]:
    files: dict[int, Path] = {}
    default = None
    for text in texts:
        match = _NODE_FILE.fullmatch(text)
        path = Path(match[2] if match else text)
        if not path.is_file():
            raise GatewayError(f"--eds {text}: not a file")
        if match is None:
            default = path
        elif int(match[1]) in NODE_IDS:
            files[int(match[1])] = path
        else:
            raise GatewayError(f"--eds {text}: node-ID {match[1]} is not allowed, expected 1..127")
    return files, default


def look_ahead(file: str, settings: Settings) -> tuple[Settings, int | None, str]:
    """The telegrams from the start of a file, the time of its first cyclic frame, and notes for the user.

    So the first packets are decoded like the last ones, and times count as in ``pdgw timeline``. Damage is reported when it is
    reached.
    """
    decoder = Decoder(replace(settings, axes=(), dictionary=None))
    zero_ns = None
    with contextlib.suppress(CaptureError), open_source(file) as source:
        for number, packet in enumerate(islice(source.packets, _LOOK_AT)):
            record = decoder.decode(packet)
            if zero_ns is None and isinstance(record, CyclicRecord):
                zero_ns = record.time_ns
            if decoder.sure or (zero_ns is None and number > _LOOK_AT_CAN):
                break
    if settings.axes or not decoder.inferred:
        return settings, zero_ns, ""
    return replace(settings, axes=decoder.inferred), zero_ns, decoder.inference
