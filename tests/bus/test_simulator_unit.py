"""The simulated machine: the rules of one unit, the motors of its sections, and lines to look at."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus.catalogue import parameters as numbers
from bus.catalogue.parameters import PARAMETERS
from bus.errors import UnitErrorCode as Code
from bus.settings import BusSettings, Dialect
from bus.simulator.plant import STEP_S, DemoLine, Plant, Section, demo_line
from bus.simulator.unit import Inputs, Memory, Mode, Traits, Unit, respond
from bus.wire.commands import (
    Ack,
    ExecuteSpeedRequest,
    Nak,
    ParameterReply,
    ReadParameterRequest,
    ReadStatusRequest,
    Reply,
    Request,
    SetAndExecuteSpeedRequest,
    StageSpeedRequest,
    StatusReply,
    WriteAnalogOutputRequest,
    WriteOutputRequest,
    WriteParameterRequest,
    encode_reply,
    encode_request,
    parse_reply,
)
from bus.wire.framing import FrameDecoder, ReceivedFrame

PLAIN = Dialect()
raw_values = st.integers(0, 99999)
writes = st.one_of(
    st.builds(StageSpeedRequest, st.just(1), raw_values),
    st.builds(ExecuteSpeedRequest, st.just(1)),
    st.builds(SetAndExecuteSpeedRequest, st.just(1), raw_values),
    st.builds(WriteParameterRequest, st.just(1), st.integers(1, 60), raw_values),
    st.builds(WriteOutputRequest, st.just(1), st.integers(1, 6), st.booleans()),
    st.builds(WriteAnalogOutputRequest, st.just(1), raw_values),
)
reads = st.one_of(
    st.builds(ReadStatusRequest, st.just(1)), st.builds(ReadParameterRequest, st.just(1), st.integers(1, 60))
)


def body_of(request: Request, dialect: Dialect = PLAIN) -> bytes:
    [frame] = FrameDecoder(dialect).feed(encode_request(request, dialect))
    assert isinstance(frame, ReceivedFrame)
    return frame.body


def exchange(unit: Unit, request: Request, dialect: Dialect = PLAIN) -> Reply | None:
    """Return the unit's response to ``request``, encoded and decoded as on the wire."""
    reply = respond(unit, body_of(request, dialect)).reply
    if reply is None:
        return None
    frame = FrameDecoder(dialect).feed(encode_reply(reply, unit.traits.dialect))[0]
    assert isinstance(frame, ReceivedFrame)
    return parse_reply(request, frame.body, dialect)


def state(unit: Unit) -> tuple[object, ...]:
    return dict(unit.memory), unit.entered, list(unit.outputs), unit.analog_output


def stopped(unit: Unit) -> Unit:
    unit.inputs.run = False
    return unit


def status(unit: Unit) -> StatusReply:
    reply = exchange(unit, ReadStatusRequest(1))
    assert isinstance(reply, StatusReply)
    return reply


@pytest.mark.parametrize("mode", [Mode.LOCAL, Mode.KEYLOCK])
@given(request=writes)
def test_writes_need_remote(mode: Mode, request: Request) -> None:
    unit = Unit()
    unit.memory[numbers.CONTROL_MODE] = mode
    before = state(unit)
    assert exchange(unit, request) == Nak(1, Code.NOT_REMOTE)
    assert state(unit) == before


@given(request=reads, mode=st.sampled_from(Mode))
def test_reads_get_a_response_in_every_mode_and_change_nothing(request: Request, mode: Mode) -> None:
    unit = Unit()
    unit.memory[numbers.CONTROL_MODE] = mode
    before = state(unit)
    assert not isinstance(exchange(unit, request), Nak) or request == ReadParameterRequest(
        1, max(41, request.number)
    )
    assert state(unit) == before


@given(st.lists(writes, max_size=30))
def test_no_sequence_of_writes_leads_out_of_the_rules(requests: list[Request]) -> None:
    """Every parameter stays in its printed range, the address stays, and locked out stays locked out."""
    unit = Unit()
    for request in requests:
        locked = unit.mode is not Mode.REMOTE
        turn = respond(unit, body_of(request))
        assert turn.acted != isinstance(turn.reply, Nak)
        assert not (locked and turn.acted)
        assert unit.address == 1
        for number, parameter in PARAMETERS.items():
            assert parameter.minimum <= unit.memory[number] <= parameter.maximum, number


def test_a_staged_speed_shows_only_once_executed() -> None:
    unit = Unit()
    assert exchange(unit, StageSpeedRequest(1, 528)) == Ack(1)
    assert status(unit).commanded == 0
    assert exchange(unit, ExecuteSpeedRequest(1)) == Ack(1)
    assert status(unit).commanded == 528


def test_the_broadcast_is_carried_out_without_a_response() -> None:
    unit = Unit()
    exchange(unit, StageSpeedRequest(1, 528))
    turn = respond(unit, bytes.fromhex("00 83"))
    assert (turn.reply, turn.acted, unit.commanded) == (None, True, 528)


def test_a_local_unit_ignores_the_broadcast() -> None:
    unit = Unit()
    exchange(unit, StageSpeedRequest(1, 528))
    unit.memory[numbers.CONTROL_MODE] = Mode.LOCAL
    turn = respond(unit, bytes.fromhex("00 83"))
    assert (turn.reply, turn.acted, unit.commanded) == (None, False, 0)


def test_execute_after_power_up_does_not_bring_back_an_old_stage() -> None:
    unit = Unit()
    exchange(unit, SetAndExecuteSpeedRequest(1, 300))
    exchange(unit, StageSpeedRequest(1, 900))
    unit.power_up()
    exchange(unit, ExecuteSpeedRequest(1))
    assert unit.commanded == 300


@pytest.mark.parametrize("command", [StageSpeedRequest, SetAndExecuteSpeedRequest])
def test_a_speed_ends_at_the_maximum_display_value(
    command: type[StageSpeedRequest | SetAndExecuteSpeedRequest],
) -> None:
    unit = Unit()
    assert exchange(unit, command(1, 2000)) == Ack(1)
    assert exchange(unit, command(1, 2001)) == Nak(1, Code.ILLEGAL_SPEED)
    assert unit.entered == 2000


@pytest.mark.parametrize(
    ("number", "raw", "refusal"),
    [
        (17, 5, Code.ILLEGAL_PARAMETER_VALUE),
        (17, 1, Code.ILLEGAL_PARAMETER_VALUE),
        (41, 0, Code.ILLEGAL_PARAMETER_NUMBER),
        (3, 5, Code.ILLEGAL_PARAMETER_VALUE),
        (15, 0, Code.ILLEGAL_PARAMETER_VALUE),
        (18, 7, Code.ILLEGAL_PARAMETER_VALUE),
        (31, 80000, Code.ILLEGAL_PARAMETER_VALUE),
        (20, 2001, Code.ILLEGAL_PARAMETER_VALUE),
        (37, 4999, Code.ILLEGAL_PARAMETER_VALUE),
    ],
)
def test_what_a_parameter_refuses(number: int, raw: int, refusal: Code) -> None:
    unit = stopped(Unit())
    assert exchange(unit, WriteParameterRequest(1, number, raw)) == Nak(1, refusal)


@pytest.mark.parametrize(("number", "response_bytes"), [(3, 1), (1, 2), (2, 4)])
def test_a_parameter_is_returned_in_the_width_of_its_type(number: int, response_bytes: int) -> None:
    reply = exchange(Unit(), ReadParameterRequest(1, number))
    assert reply == ParameterReply(1, Unit().memory[number], response_bytes)


@pytest.mark.parametrize(
    ("body", "refusal"),
    [
        ("01 80", Code.ILLEGAL_COMMAND),
        ("01 89", Code.ILLEGAL_COMMAND),
        ("01 81 00", Code.ILLEGAL_COMMAND),
        ("01 84 00 02", Code.ILLEGAL_COMMAND),
        ("01 87 07 01", Code.ILLEGAL_OUTPUT_NUMBER),
        ("01 87 00 01", Code.ILLEGAL_OUTPUT_NUMBER),
        ("01 87 01 02", Code.ILLEGAL_OUTPUT_VALUE),
        ("01 84 00 01 86 A0", Code.ILLEGAL_SPEED),
    ],
)
def test_an_unknown_command_is_refused(body: str, refusal: Code) -> None:
    assert respond(Unit(), bytes.fromhex(body)).reply == Nak(1, refusal)


@pytest.mark.parametrize("healthy", [0, 1])
@given(
    inputs=st.builds(Inputs, *[st.booleans()] * 6), outputs=st.lists(st.booleans(), min_size=6, max_size=6)
)
def test_the_status_bits_are_where_the_manual_puts_them(
    healthy: int, inputs: Inputs, outputs: list[bool]
) -> None:
    unit = Unit(traits=Traits(Dialect(estop_healthy=healthy)))  # type: ignore[arg-type]
    unit.inputs, unit.outputs = inputs, outputs
    reply = status(unit)
    contacts = (
        inputs.run,
        inputs.estop ^ bool(healthy),
        inputs.preset,
        inputs.reverse,
        inputs.up,
        inputs.down,
    )
    assert reply.inputs == sum(on << bit for bit, on in enumerate(contacts))
    assert reply.outputs & 0x3F == sum(on << bit for bit, on in enumerate(outputs))
    assert reply.outputs & 0x40


def responses(line: DemoLine) -> bytes:
    """Return the responses of every unit to 81h."""
    sent = b""
    for unit in line.plant.units:
        reply = respond(unit, bytes((unit.address, 0x81))).reply
        assert reply is not None
        sent += encode_reply(reply, unit.traits.dialect)
    return sent


def run(line: DemoLine, seconds: int) -> None:
    for _ in range(round(seconds / STEP_S)):
        line.plant.step()


def test_the_same_seed_gives_the_same_bytes_after_a_minute() -> None:
    lines = [demo_line(8, seed=seed) for seed in (5, 5, 6)]
    for line in lines:
        run(line, 60)
    first, same, other = map(responses, lines)
    assert first == same
    assert first != other


def test_the_default_demo_is_eight_named_sections_that_run_in_metres_a_minute() -> None:
    line = demo_line()
    assert [unit.name for unit in line.settings] == [
        "Unwind",
        "Infeed nip",
        "Coater",
        "Dryer 1",
        "Dryer 2",
        "Cooling drum",
        "Pull nip",
        "Rewind",
    ]
    for unit in line.plant.units:
        assert (unit.memory[numbers.DECIMALS], unit.follows) == (1, False)
        assert unit.measured.actual == pytest.approx(1200, abs=10)
        assert unit.at_speed


@pytest.mark.parametrize("count", [1, 8, 9, 32, 255])
def test_any_number_of_units_makes_a_bus_that_the_settings_take(count: int) -> None:
    line = demo_line(count)
    bus = BusSettings(name="demo", port="/dev/null", unit=line.settings)
    assert [unit.id for unit in bus.unit] == [unit.address for unit in line.plant.units]
    assert len({unit.name for unit in bus.unit}) == count
    assert not line.plant.units[0].follows
    assert any(unit.follows for unit in line.plant.units) == (count >= 16)


@pytest.mark.parametrize("unrest", [True, False])
def test_a_line_without_unrest_measures_the_same_as_long_as_nothing_is_changed(unrest: bool) -> None:
    line = demo_line(4, script=False, unrest=unrest)
    for _ in range(100):  # until the web is taut
        line.plant.step()
    measured = set()
    for _ in range(100):
        line.plant.step()
        measured.add(tuple((unit.measured.actual, unit.measured.analog) for unit in line.plant.units))
    assert (len(measured) == 1) is not unrest


def test_the_demo_line_is_mostly_well_and_not_always() -> None:
    """Of the moments of ten minutes nearly all are without a stopped section, yet each habit is seen."""
    line = demo_line()
    steps = round(600 / STEP_S)
    stopped, seen = 0, set()
    for _ in range(steps):
        line.plant.step()
        contacts = [unit.inputs for unit in line.plant.units]
        stopped += any(inputs.estop or not inputs.run for inputs in contacts)
        seen |= {
            name for inputs in contacts for name in ("estop", "preset", "up", "down") if getattr(inputs, name)
        }
    assert seen == {"estop", "preset", "up", "down"}
    assert 0.02 < stopped / steps < 0.2


def test_followers_follow_the_first_unit_that_is_a_master() -> None:
    master, follower = Unit(), Unit()
    follower.memory[numbers.OWN_ADDRESS], follower.memory[numbers.FOLLOWER_MODE] = 2, 1
    master.setpoint, follower.setpoint = 1000, 5000
    plant = Plant([Section(follower), Section(master, seed=2)])
    for _ in range(600):
        plant.step()
    assert follower.measured.actual == pytest.approx(500, abs=5)


DT = 0.05
FULL = 2000


def section(seed: int = 1, **values: int) -> Section:
    """A section with #1 1750 rpm, #2 2000 and ramps of 10 s for the full span, but for ``values``."""
    named = {getattr(numbers, name): raw for name, raw in values.items()}
    return Section(Unit(Memory(named)), seed)


def turn(machine: Section, seconds: float, master_rpm: float = 0.0, upstream: Section | None = None) -> int:
    for _ in range(round(seconds / DT)):
        machine.step(DT, master_rpm, upstream)
    return machine.unit.measured.actual


@pytest.mark.parametrize(("seconds", "share"), [(2.5, 0.25), (5, 0.5), (20, 1.0)])
def test_it_accelerates_by_the_time_for_the_full_span(seconds: float, share: float) -> None:
    machine = section(SPEED_SETPOINT=FULL, ACCELERATION=100)
    assert turn(machine, seconds) == pytest.approx(FULL * share, abs=40)


def test_a_drive_that_does_not_run_coasts_and_runs_up_again_from_where_it_is() -> None:
    machine = section(SPEED_SETPOINT=FULL, ACCELERATION=100)
    turn(machine, 20)
    machine.unit.inputs.run = False
    coasting = turn(machine, 2)
    assert 0 < coasting < FULL * 0.6
    assert not machine.unit.at_speed
    machine.unit.inputs.run = True
    assert turn(machine, 1) > coasting
    machine.unit.inputs.run = False
    assert turn(machine, 60) == 0


def test_an_emergency_stop_is_much_faster_than_coasting() -> None:
    machine = section(SPEED_SETPOINT=FULL)
    turn(machine, 20)
    machine.unit.inputs.estop = True
    assert turn(machine, 1) < FULL * 0.05
    assert turn(machine, 3) == 0
    assert machine.unit.commanded == FULL


@pytest.mark.parametrize(("ratio", "base"), [(10000, 10000), (5000, 10000), (10500, 10000), (10000, 5000)])
def test_a_follower_holds_its_ratio_to_the_master(ratio: int, base: int) -> None:
    machine = section(FOLLOWER_MODE=1, RATIO_SETPOINT=ratio, BASE_RATIO=base)
    actual = turn(machine, 30, master_rpm=875)
    expected = FULL / 2 * ratio / 10000 * base / 10000
    assert actual == pytest.approx(expected, abs=5)
    assert machine.unit.measured.following == pytest.approx(expected, abs=1)
    assert machine.unit.measured.ratio == pytest.approx(ratio, rel=0.01)
    assert machine.unit.at_speed


def test_everything_shown_fits_its_bytes() -> None:
    machine = section(SPEED_SETPOINT=99999, MAX_DISPLAY=99999, ACCELERATION=0)
    for estop in (False, True):
        machine.unit.inputs.estop = estop
        for _ in range(200):
            machine.step(DT, 0.0, None)
            assert 0 <= machine.unit.measured.actual <= 99999
            assert 0 <= machine.unit.measured.analog <= 255
