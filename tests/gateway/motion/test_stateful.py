"""Whatever a PLC asks, in whatever order: what the axis must and must not do, in an engineer's words."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from pdgw.gateway.motion.blocks import Block, BlockMode, BlockNext, BlockTask
from pdgw.gateway.motion.requests import FULL, Command, MotionKind, Seen
from pdgw.gateway.motion.states import State
from tests.support.axis.positioner import RAMP, SETTINGS, PositionerRig, changed, command

LIMIT = 20_000
FASTEST = 400
"""LU per cycle at the highest speed with the highest override."""
OVERRUN = FASTEST * (FASTEST + RAMP) // (2 * RAMP) + FASTEST
BLOCKS = (
    Block(1, 5000, 2000, next=BlockNext.FLYING),
    Block(2, -3000, 1000, mode=BlockMode.RELATIVE, next=BlockNext.CONTINUE_WITH_STOP),
    Block(3, task=BlockTask.WAIT, value=40, next=BlockNext.CONTINUE_WITH_STOP),
    Block(4, 0, 3000, mode=BlockMode.ENDLESS_POSITIVE, next=BlockNext.EXTERNAL),
    Block(5, 0, 3000, task=BlockTask.FIXED_STOP, value=100),
)
FLAGS = st.sampled_from(
    (
        *("activate", "jog_1", "jog_2", "jog_incremental", "homing", "passive_homing", "tracking"),
        *("set_reference_point", "no_intermediate_stop", "do_not_reject", "mdi", "setting_up", "absolute"),
        *("positive", "negative", "continuous_update", "external_block_change", "to_fixed_stop"),
        *("software_limits", "operating"),
    )
)
JOGS = Command.JOG_1_ON | Command.JOG_2_ON


class Life(RuleBasedStateMachine):
    """One axis and a PLC that does anything."""

    @initialize(delay=st.integers(0, 4), waiting=st.booleans())
    def power_up(self, delay: int, waiting: bool) -> None:
        values = replace(SETTINGS, waiting_setpoints=waiting, software_limits=(-LIMIT, LIMIT), max_velocity=3000)
        self.rig = PositionerRig(values, BLOCKS, delay)
        self.permitted = False
        """Something that may start a motion came since operation was enabled last."""

    def cycles(self, count: int) -> None:
        for _ in range(count):
            before, request = self.rig.speed, self.rig.request
            self.rig.step()
            faster = abs(self.rig.speed) > abs(before)
            both = request.commands & JOGS == JOGS
            if both and self.rig.result.state in {State.JOG, State.JOG_INCREMENTAL, State.BRAKING}:
                assert not faster, "jog moves with both bits"
            if not request.commands & Command.DO_NOT_REJECT or not self.rig.seen.bits & Seen.OPERATING:
                assert not faster, "moves in spite of a reject or without operation"
            if not self.permitted:
                assert not faster, "something survived what ends it all"

    @rule(name=FLAGS, count=st.integers(0, 20))
    def toggle(self, name: str, count: int) -> None:
        request, seen = self.rig.request, self.rig.seen
        if name == "operating":
            self.rig.show(Seen.OPERATING, not seen.bits & Seen.OPERATING)
            self.permitted = False
            self.cycles(count)
            return
        value = not (getattr(request, name) if hasattr(request, name) else request.commands & command(name))
        self.rig.request = changed(request, **{name: value})
        if value and seen.bits & Seen.OPERATING:
            self.permitted = self.permitted or name in {"activate", "jog_1", "jog_2", "homing"}
        elif name in {"jog_1", "jog_2"} and self.permitted:
            self.permitted = True
        self.cycles(count)

    @rule(
        end=st.integers(-30_000, 30_000),
        velocity=st.sampled_from([0, 100, 3000, 5000]),
        number=st.integers(0, 6),
        override=st.sampled_from([0, 0x800, FULL, 0x7FFF]),
        count=st.integers(0, 20),
    )
    def change_values(self, end: int, velocity: int, number: int, override: int, count: int) -> None:
        values = {"target": end, "velocity": velocity, "number": number, "override": override}
        self.rig.request = replace(self.rig.request, **values)
        self.cycles(count)

    @rule(count=st.integers(20, 120))
    def wait(self, count: int) -> None:
        self.cycles(count)

    @invariant()
    def a_set_point_is_given_once_and_the_same_task_never_twice(self) -> None:
        rig = getattr(self, "rig", None)
        if rig is not None:
            serials = [motion.serial for motion in rig.starts]
            assert serials == sorted(set(serials))

    @invariant()
    def reached_is_only_shown_at_standstill(self) -> None:
        rig = getattr(self, "rig", None)
        if rig is not None and rig.result.reached and rig.result.state is State.IDLE:
            assert rig.result.motion.kind is MotionKind.STAND


TestLife = Life.TestCase
TestLife.settings = settings(max_examples=30, stateful_step_count=40, deadline=None)


@given(
    distance=st.integers(-30_000, 30_000).filter(bool),
    delay=st.integers(0, 5),
    disturbances=st.lists(
        st.tuples(st.integers(1, 15), st.booleans(), st.sampled_from([0, 0x400, FULL, 0x7FFF])), max_size=12
    ),
)
def test_a_relative_task_is_done_exactly_once_whatever_stops_and_overrides_come(
    distance: int, delay: int, disturbances: list[tuple[int, bool, int]]
) -> None:
    rig = PositionerRig(delay=delay)
    rig.step(activate=True, mdi=True, target=distance, velocity=2000)
    for count, go_on, override in disturbances:
        rig.step(count, no_intermediate_stop=go_on, override=override)
    rig.step(no_intermediate_stop=True, override=FULL)
    rig.run_out()
    assert rig.position == distance
    assert rig.result.reached


@given(
    targets=st.lists(st.tuples(st.integers(-20_000, 20_000), st.integers(0, 60)), min_size=1, max_size=10),
    delay=st.integers(0, 5),
)
def test_continuous_update_ends_at_the_newest_target_and_never_starts_a_second_motion(
    targets: list[tuple[int, int]], delay: int
) -> None:
    rig = PositionerRig(delay=delay)
    first = targets[0][0]
    rig.step(activate=True, mdi=True, absolute=True, continuous_update=True, target=first, velocity=3000)
    for target, count in targets:
        rig.step(1 + count, target=target)
    rig.run_out()
    assert (rig.position, rig.result.acknowledged) == (targets[-1][0], True)
    distinct = 1 + sum(a != b for (a, _), (b, _) in pairwise(targets))
    assert len(rig.starts) <= distinct
    taken = len(rig.starts)
    rig.step(activate=False)
    rig.step(50, target=0)
    rig.step(50, target=5)
    assert len(rig.starts) == taken


@given(
    functions=st.lists(
        st.tuples(
            st.sampled_from(["jog_1", "jog_2", "setting up", "task", "block"]),
            st.integers(-60_000, 60_000),
            st.booleans(),
            st.integers(1, 150),
        ),
        max_size=12,
    )
)
def test_no_function_goes_beyond_a_software_limit_that_is_watched(
    functions: list[tuple[str, int, bool, int]],
) -> None:
    rig = PositionerRig(replace(SETTINGS, software_limits=(-LIMIT, LIMIT), max_velocity=3000), BLOCKS)
    rig.home()
    for function, end, forward, count in functions:
        rig.step(2, activate=False, jog_1=False, jog_2=False, do_not_reject=False)
        rig.step(2, do_not_reject=True)
        if function in {"jog_1", "jog_2"}:
            rig.step(**{function: True})
        else:
            rig.step(
                activate=True,
                mdi=function != "block",
                number=1 + abs(end) % 4,
                setting_up=function == "setting up",
                absolute=forward,
                positive=forward,
                negative=not forward,
                target=end,
                velocity=3000,
            )
        for _ in range(count):
            rig.step()
            assert abs(rig.position) <= LIMIT


@given(bit=st.sampled_from(["jog_1", "jog_2"]), cycles=st.integers(0, 104))
def test_a_limit_that_is_watched_late_is_overrun_by_the_ramp_at_most(bit: str, cycles: int) -> None:
    rig = PositionerRig(replace(SETTINGS, software_limits=(-LIMIT, LIMIT)))
    rig.home()
    rig.step(software_limits=False, **{bit: True})
    rig.step(cycles)
    assert abs(rig.position) <= LIMIT
    rig.step(software_limits=True)
    for _ in range(200):
        rig.step()
        assert abs(rig.position) <= LIMIT + OVERRUN
