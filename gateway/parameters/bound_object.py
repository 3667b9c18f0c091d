"""A drive object made of bound parameters: each number with the functions that read and write it, and the lists P980 ff.

Source: PROFIdrive profile 4.1 chapter 6.2 (parameter model), docs/parameter-channel.md "Profile parameters".
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from pdgw.gateway.parameters.objects import RequestContext
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.parameters.catalogue import LIST_PNUS, PARAMETERS
from pdgw.profidrive.parameters.error_numbers import ParameterErrorNumber as Number
from pdgw.profidrive.parameters.error_numbers import ParameterRefused
from pdgw.profidrive.parameters.model import BoundParameter, Parameter

_LIST_SIZE = 99
"""Parameters of a list; more only where ten lists do not suffice."""

Getter = Callable[[], int | float | bytes | Sequence[int]]
Setter = Callable[[int], None]


class BoundObject:
    """A drive object made of bound profile parameters, and CANopen objects where ``objects`` finds them."""

    def __init__(self, do_id: int) -> None:
        self.do_id = do_id
        self._parameters: dict[int, Callable[[RequestContext], Parameter]] = {}

    def bind(
        self,
        pnu: int,
        get: Getter,
        set: Setter | None = None,
        *,
        texts: Callable[[], Sequence[str]] | None = None,
        data_type: DataType | None = None,
    ) -> None:
        """Functions of a declared parameter; ``data_type`` if it differs from the declaration."""
        parameter = BoundParameter(PARAMETERS[pnu], get, set, data_type, texts)
        self._parameters[pnu] = lambda _: parameter

    def bind_action(self, pnu: int, action: Callable[[RequestContext], None]) -> None:
        """P970 and similar: writing 1 does ``action``, 0 nothing; 0 is read when it is done."""
        self._parameters[pnu] = lambda context: BoundParameter(
            PARAMETERS[pnu], lambda: 0, lambda value: action(context) if value else None
        )

    def adopt(self, other: BoundObject) -> None:
        """Answer for the parameters of another object that this one does not have."""
        self._parameters = {**other._parameters, **self._parameters}

    def parameter(self, pnu: int, context: RequestContext) -> Parameter:
        """The parameter for one request; ParameterRefused (impermissible PNU) if it is unknown."""
        if pnu in LIST_PNUS:
            self.bind_lists()  # the objects of a node may have been read meanwhile
        try:
            return self._parameters[pnu](context)
        except KeyError:
            raise ParameterRefused(Number.IMPERMISSIBLE_PNU) from None

    def check_writable(self, pnu: int) -> None:
        """Everything may be written."""

    def further_pnus(self) -> Iterable[int]:
        """Parameters beside the bound ones."""
        return ()

    def bind_lists(self) -> None:
        """P980 ff: all parameters that exist but the lists, chained; call it when everything else is bound."""
        self._parameters = {pnu: item for pnu, item in self._parameters.items() if pnu not in LIST_PNUS}
        pnus = sorted({*self._parameters, *self.further_pnus()})
        size = max(_LIST_SIZE, -(-len(pnus) // len(LIST_PNUS)))
        parts = [pnus[start : start + size] for start in range(0, len(pnus), size)]
        for pnu, part in zip(LIST_PNUS, parts, strict=False):
            follower = pnu + 1 if part is not parts[-1] else 0
            self.bind(pnu, _constant((*part, follower)))


@dataclass(frozen=True, slots=True)
class RequestedObject:
    """A drive object as one request sees it."""

    drive_object: BoundObject
    context: RequestContext

    def parameter(self, pnu: int) -> Parameter:
        return self.drive_object.parameter(pnu, self.context)

    def check_writable(self, pnu: int) -> None:
        self.drive_object.check_writable(pnu)


def _constant(value: Sequence[int]) -> Getter:
    return lambda: value
