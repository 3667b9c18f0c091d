"""A capture as the records in it, for programs: open, decode, iterate."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from os import PathLike, fspath

from pdgw.decoder.capture.source import open_source
from pdgw.decoder.frames.engine import Decoder, Settings, given_axes
from pdgw.decoder.frames.records import Record


def read_records(path: str | PathLike[str], telegrams: Sequence[int] = ()) -> Iterator[Record]:
    """Read the records of a capture of either bus (pcap, pcapng, candump, python-can's logs), one for each packet, in order.

    ``telegrams``: those of the axes, in the order of the frame; without them they are inferred, and the first frames are
    undecided. Raises CaptureError for a file that cannot be opened, has an unknown format or ends early, ProfidriveError for a
    telegram that does not exist.
    """
    decoder = Decoder(Settings(given_axes(telegrams)))
    with open_source(fspath(path)) as source:
        for packet in source.packets:
            yield decoder.decode(packet)
