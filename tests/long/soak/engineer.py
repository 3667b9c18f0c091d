"""A client of the parameter channel in the soak: reads, writes values back, changes telegrams, compares the fault buffer."""

from __future__ import annotations

import uuid
from collections.abc import Sequence
from random import Random
from typing import Final

from pdgw.dsp402.objects import PROFILE_ACCELERATION, PROFILE_DECELERATION, QUICK_STOP_DECELERATION
from pdgw.gateway.axis.values import FaultRecord
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.udp import Address
from pdgw.gateway.client.udp import ParameterClient
from pdgw.peers.world import World, WorldChannel
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.parameters.codec import ParameterAddress, Values
from pdgw.profidrive.parameters.description import Pnu
from pdgw.profidrive.parameters.faults import SIZE
from pdgw.profinet.rpc.client import RecordCaller
from pdgw.profinet.rpc.dcerpc import object_uuid
from tests.long.soak.emcy_check import PendingEmcys

HOST: Final = "192.168.0.20"
_STATUSWORD = 0x6041
_READ: Final = (Pnu.TELEGRAM, Pnu.FAULT_COUNTER, Pnu.WARNING_WORD, _STATUSWORD, PROFILE_ACCELERATION)
_WRITTEN: Final = (PROFILE_ACCELERATION, PROFILE_DECELERATION, QUICK_STOP_DECELERATION, Pnu.SIGN_OF_LIFE_TOLERANCE)
"""Written with their present value. The drive rejects the second and third under power; the gateway reads them again
without.
"""


class Engineer:
    """Its methods wait, so call them only in tasks of the world's loop. Without an answer, or when rejected, they return
    None.
    """

    def __init__(self, world: World, gateway: Address, chance: Random) -> None:
        self._world = world
        self._gateway = gateway
        self._chance = chance

    def _request(
        self, do_id: int, pnus: Sequence[int], values: list[Values] | None = None, host: str = HOST, elements: int = 0
    ) -> list[Values] | None:
        channel = WorldChannel(self._world, self._gateway, host)
        caller = RecordCaller(uuid.UUID(int=self._chance.getrandbits(128)), object_uuid(1, 0, 0))
        try:
            with ParameterClient(self._gateway, do_id, channel=channel, caller=caller, timeout_s=3) as client:
                answers = client.request([ParameterAddress(pnu, 0, elements) for pnu in pnus], values)
        except GatewayError:
            return None
        return None if any(answer.failed for answer in answers) else answers

    def act(self, do_id: int) -> str:
        """Read a parameter or write its present value. Return a description."""
        if self._chance.random() < 0.5:
            pnu = self._chance.choice(_READ)
            self._request(do_id, [pnu])
            return f"read {pnu}"
        pnu = self._chance.choice(_WRITTEN)
        values = self._request(do_id, [pnu])
        taken = values is not None and self._request(do_id, [pnu], values) is not None
        return f"write {pnu} with its value: {'taken' if taken else 'refused or not answered'}"

    def select(self, do_id: int, number: int, host: str) -> bool:
        """Write P922 from the PLC's own address. False when the gateway keeps the old telegram."""
        written = [Values(DataType.UNSIGNED16, (number,))]
        self._request(do_id, [Pnu.TELEGRAM], written, host)
        while (read := self._request(do_id, [Pnu.TELEGRAM], host=host)) is None:
            self._world.loop.sleep(self._world.network.conditions.delay_ns)
        return read[0].values == (number,)

    def look(self, do_id: int, pending: PendingEmcys, origin: int, history: Sequence[FaultRecord]) -> None:
        """Compare fault buffer and ``history`` with the EMCYs of the drive; ViolationError for a missing one."""
        asked_at = self._world.loop.now()
        answers = self._request(do_id, [Pnu.FAULT_CODE, Pnu.FAULT_TIME], elements=SIZE)
        if answers is not None:
            codes, times = ([int(value) for value in answer.values] for answer in answers)
            pending.read(asked_at, origin, codes, times, history)
