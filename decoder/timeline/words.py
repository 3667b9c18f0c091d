"""The four words of an axis: where they change, and which decision of today's machine a change shows. Without I/O."""

from __future__ import annotations

from collections import deque
from typing import Final, NamedTuple

from pdgw.decoder.frames.fields import entry_field, half_fields
from pdgw.decoder.timeline.drive_object import Put
from pdgw.decoder.timeline.entries import Edge, WordKind
from pdgw.dsp402.identification.overlay import all_families
from pdgw.dsp402.objects import CONTROL_ATTRIBUTE, DRIVE_OBJECTS, STATUS_ATTRIBUTE
from pdgw.profidrive.telegrams import Telegram

_WAITING: Final = 8
"""Edges and decisions of one word that wait for each other."""


class Decision(NamedTuple):
    """A word today's machine changed in a step, and the edge it took in this step."""

    time_ns: int
    before: int
    after: int
    cause: Edge | None

    def explains(self, edge: Edge) -> bool:
        """Whether both change to the same word, or a bit alike for a cause: a value may come a step sooner or later."""
        if self.cause is None:
            return self.after == edge.after
        common = (self.before ^ self.after) & (edge.before ^ edge.after)
        return bool(common) and not (self.after ^ edge.after) & common


class Words:
    """The words as recorded, and the decisions that explain their changes within ``tolerance_ns``."""

    def __init__(self, do_id: int, telegram: Telegram, tolerance_ns: int, put: Put, *, one_clock: bool) -> None:
        self.values: dict[WordKind, int] = {}
        self.fields = {
            WordKind.CONTROL: half_fields(telegram.setpoints)[0],
            WordKind.STATUS: half_fields(telegram.actuals)[0],
        }
        self.are_of(all_families())
        self._do_id = do_id
        self._tolerance = tolerance_ns
        self._early = 0 if one_clock else tolerance_ns
        """So much sooner than its cause an edge may seem to come."""
        self._put = put
        self._decisions = {kind: deque[Decision](maxlen=_WAITING) for kind in WordKind}
        self._unexplained = {kind: deque[Edge](maxlen=_WAITING) for kind in WordKind}

    def are_of(self, families: tuple[str, ...]) -> None:
        """The words on CAN are those of a drive of one of these families."""
        for kind, attribute in ((WordKind.CONTROLWORD, CONTROL_ATTRIBUTE), (WordKind.STATUSWORD, STATUS_ATTRIBUTE)):
            self.fields[kind] = entry_field(DRIVE_OBJECTS.attribute(attribute), families)

    def edge(self, kind: WordKind, now: int, value: int) -> Edge | None:
        """A recorded word; the edge when it is another one than before."""
        before = self.values.get(kind)
        self.values[kind] = value
        if before is None or before == value:
            return None
        edge = Edge(now, self._do_id, kind, self.fields[kind], before, value)
        self._put(edge)
        return edge

    def explain(self, kind: WordKind, edge: Edge) -> None:
        """Set the cause of a recorded edge to that of the decision it shows; the decision may follow later."""
        decisions = self._decisions[kind]
        while decisions and decisions[0].time_ns < edge.time_ns - self._tolerance:
            decisions.popleft()
        fitting = [decision for decision in decisions if decision.explains(edge)]
        decision = next((item for item in fitting if item.after == edge.after), fitting[0] if fitting else None)
        if decision is not None:
            while decisions.popleft() is not decision:
                pass
            if decision.cause is not None:
                edge.follow(decision.cause)
            return
        self._unexplained[kind].append(edge)

    def decided(self, kind: WordKind, decision: Decision) -> None:
        """Today's machine has changed a word."""
        edges = self._unexplained[kind]
        while edges and edges[0].time_ns < decision.time_ns - self._tolerance:
            edges.popleft()
        for edge in tuple(edges):
            sooner = decision.cause.time_ns - edge.time_ns if decision.cause is not None else 0
            if sooner <= self._early and decision.explains(edge):
                edges.remove(edge)
                if decision.cause is not None and decision.cause is not edge:
                    edge.follow(decision.cause)
                return
        self._decisions[kind].append(decision)
