"""The native cyclic engine (``engine.c``), which a build may lack: its table of protocol facts, and how to make one.

The engine takes the cyclic frames of one relationship over from ``Consumer`` and ``Provider``, in a thread that needs no
interpreter. It hands each frame whose orders differ from those before it to Python, in their order, and of all others the newest.
Python judges these again, so its rules stay the only ones for what a frame does. Linux only; without it everything runs
in Python.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from importlib.util import find_spec
from typing import Any, Final, Protocol, cast

from pdgw.gateway.links.cyclic import control_mask
from pdgw.profidrive.frame import (
    COUNTER_NEWEST,
    HEADER,
    IOPS_BAD,
    STATUS_DATA_VALID,
    STATUS_PRIMARY,
    STATUS_RUN,
    TRAILER,
)
from pdgw.profidrive.telegrams import Telegram
from pdgw.profinet import ethernet
from pdgw.profinet.connection.cmdev import ApplicationRelation
from pdgw.profinet.connection.cpm import STATUS_IGNORE, Consumer, Verdict
from pdgw.profinet.connection.ppm import Provider
from pdgw.profinet.model import TELEGRAM_SUBSLOT

Table = Mapping[str, Any]
_MODULE: Final = "pdgw.gateway.links.profinet.engine"
VERDICTS: Final = (
    Verdict.ACCEPTED,
    Verdict.PROVIDER_STOP,
    Verdict.NO_DATA,
    Verdict.LENGTH,
    Verdict.TRANSFER_STATUS,
    Verdict.NOT_VALID,
    Verdict.STALE,
)
"""The engine's numbers 0 to 6."""
FOREIGN, OTHER = 7, 8
"""A real-time frame that is not the controller's; one of the controller that is not cyclic."""
COUNTS: Final = (
    *VERDICTS,
    *("foreign", "other", "sent", "missed", "invalid", "withheld", "dropped", "errors", "octets in", "octets out"),
)
"""Elements of ``Engine.counts``, in order. Frames returned by ``take`` are not among the received ones."""
_SILENT_CYCLES: Final = 4
"""Number of cycles of the gateway without a step of the drive objects after which their data is not valid."""
_ALL: Final = 0xFF


class Engine(Protocol):
    """The exchange of one relationship."""

    def start(self, descriptor: int, /) -> None:
        """Receive from and send to this socket, in a thread; OSError where there is none."""

    def stop(self) -> None:
        """End the thread."""

    def fileno(self) -> int:
        """A descriptor that is readable when something is to be taken."""

    def take(self, oldest_ns: int, /) -> tuple[bytes, int, bool] | None:
        """The next frame, when the newest cyclic one came (-1: this one is none), and whether orders before it were lost.

        All orders that wait are lost if one of them came before ``oldest_ns``, or if they were too many.
        """

    def publish(self, frame: bytes | bytearray, stepped_ns: int, /) -> None:
        """The input frame from now on, and when the drive objects made the last step."""

    def counts(self) -> tuple[int, ...]:
        """The counts since the last call, in the order of ``COUNTS``."""

    @property
    def more(self) -> bool:
        """More data waits after the result of ``take``."""

    @property
    def counter(self) -> int:
        """CycleCounter of the last input frame."""


def is_built() -> bool:
    """Whether this installation has an engine."""
    return find_spec(_MODULE) is not None


def make(table: Table) -> Engine | None:
    """An engine; None where there is none, or one of another version."""
    try:
        return cast(Engine, import_module(_MODULE).Engine(**table))
    except (ImportError, TypeError, ValueError, OSError):
        return None


def order_mask(consumer: Consumer, telegrams: Sequence[Telegram]) -> bytes:
    """The bits of a frame from its FrameID on that are orders: all but the cycle counter, setpoints and signs of life."""
    mask = bytearray([_ALL]) * consumer.size
    mask[consumer.trailer : consumer.trailer + 2] = bytes(2)
    for index, telegram in enumerate(telegrams):
        where = consumer.place((index + 1, TELEGRAM_SUBSLOT))
        orders = control_mask(telegram.setpoints)
        if where is not None and where[1] - where[0] == len(orders):
            mask[where[0] : where[1]] = orders
    return bytes(mask)


def bound_ns(relation: ApplicationRelation, cycle_ns: int) -> int:
    """Greatest age of the drive objects' last step. ``cycle_ns``: cycle of the gateway."""
    block = relation.plan.inputs.block if relation.plan.inputs is not None else None
    return max(0 if block is None else block.hold_ns, _SILENT_CYCLES * cycle_ns)


def table_of(
    relation: ApplicationRelation,
    consumer: Consumer,
    provider: Provider,
    telegrams: Sequence[Telegram],
    *,
    cycle_ns: int,
    now: int,
) -> Table:
    """The facts of one relationship, for ``make``. ``cycle_ns``: of the gateway, each of which Python is woken."""
    bad = bytearray([_ALL]) * len(provider.frame)
    for place in provider.statuses:
        bad[place] = IOPS_BAD
    return {
        "head": relation.head,
        "tag": HEADER.pack(ethernet.ETHERTYPE_TAG),
        "tag_size": ethernet.TAG_SIZE,
        "counter_at": consumer.trailer,
        "status_at": consumer.trailer + 2,
        "transfer_at": consumer.trailer + TRAILER.size - 1,
        "order_mask": order_mask(consumer, telegrams),
        "newest": COUNTER_NEWEST,
        "valid": STATUS_DATA_VALID,
        "ignore": STATUS_IGNORE,
        "primary": STATUS_PRIMARY,
        "run": STATUS_RUN,
        "counter": -1 if consumer.counter is None else consumer.counter,
        "wake_each": max(1, cycle_ns // consumer.cycle_ns),
        "frame": bytes(provider.frame),
        "bad_mask": bytes(bad),
        "sent_at": provider.trailer,
        "sent_counter": provider.counter,
        "step": provider.step,
        "cycle_ns": provider.cycle_ns,
        "align": consumer.cycle_ns == provider.cycle_ns,
        "due": provider.due,
        "bound_ns": bound_ns(relation, max(cycle_ns, provider.cycle_ns)),
        "now": now,
    }
