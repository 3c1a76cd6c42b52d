"""What frames say, in words for people and as fields for programs (``lineside decode``, the trace).

Field names are those of the HTTP API (contract): ``raw`` is the integer on the wire. An answer names
neither its command nor its parameter; where the request is not at hand the words say what is open.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TypeAlias

from msgspec.structs import replace

from bus.catalogue.parameters import PARAMETERS
from bus.catalogue.status import StatusBits, status_bits
from bus.clauses import Clause, in_english
from bus.errors import UNNAMED_UNIT_ERROR, UnitErrorCode, unit_error_name
from bus.settings import Dialect
from bus.wire.bodies import IllegalRequest, parse_reply, parse_request
from bus.wire.commands import (
    Ack,
    Nak,
    ParameterReply,
    ReadParameter,
    ReadStatus,
    Reply,
    Request,
    SetAndExecuteSpeed,
    StageSpeed,
    StatusReply,
    WriteAnalogOutput,
    WriteOutput,
    WriteParameter,
)
from bus.wire.framing import ACK, NAK, FrameDecoder, Noise, Received, ReceivedFrame, checksum

Json: TypeAlias = "bool | int | str | list[Json] | dict[str, Json] | None"

_KINDS = {
    0x81: ("read_status", "read speed and status", "read speed and status"),
    0x82: ("set_speed", "set speed (staged)", "set speed (staged) {raw}"),
    0x83: ("execute_speed", "execute speed", "execute speed"),
    0x84: ("set_and_execute_speed", "set and execute speed", "set and execute speed {raw}"),
    0x85: ("read_parameter", "read parameter", "read parameter {parameter}"),
    0x86: ("write_parameter", "write parameter", "write parameter {parameter} = {raw}"),
    0x87: ("write_output", "write auxiliary output", "write auxiliary output {output} {state}"),
    0x88: ("write_analog_output", "write analog output", "write analog output {raw}"),
}
"""Of each command: its name for programs, its name in words, and how one is told."""
_PARAMETER_VALUE_WIDTHS = (1, 2, 4)


@dataclass(frozen=True, slots=True)
class Described:
    """One frame, or a frame whole but for its checksum. ``clauses`` never show a secret, ``fields`` do."""

    uid: int
    kind: str
    fields: dict[str, Json]
    clauses: tuple[Clause, ...]
    wire: bytes
    checksum_ok: bool = True
    request: Request | None = None
    """What it asks, where it is a request."""

    @property
    def words(self) -> str:
        """What it says, in English."""
        return in_english(self.clauses)

    def as_json(self) -> dict[str, Json]:
        """The object of ``lineside decode --json``."""
        return {
            "uid": self.uid,
            "kind": self.kind,
            "fields": self.fields,
            "checksum_ok": self.checksum_ok,
        }


@dataclass(frozen=True, slots=True)
class DescribedNoise:
    """Bytes that are no frame."""

    wire: bytes
    clauses: tuple[Clause, ...]

    @property
    def words(self) -> str:
        """Why not, in English."""
        return in_english(self.clauses)


class Describer:
    """Frames in their order, so that an answer is read in the light of the request before it."""

    def __init__(self, dialect: Dialect) -> None:
        self._dialect = dialect
        self._asked: Request | None = None

    def describe(self, received: Iterable[Received]) -> list[Described | DescribedNoise]:
        """Everything but the doubled checksum bytes, which belong to the frames before them."""
        described: list[Described | DescribedNoise] = []
        for item in received:
            if isinstance(item, ReceivedFrame):
                described.append(self._frame(item.body, item.wire))
            elif isinstance(item, Noise):
                described.append(self._noise(item))
        return described

    def _frame(self, body: bytes, wire: bytes) -> Described:
        described = describe_body(body, wire, self._dialect, self._asked)
        self._asked = described.request
        return described

    def _noise(self, noise: Noise) -> Described | DescribedNoise:
        if not noise.body:
            no_frame = Clause("{count} bytes that are no frame", {"count": len(noise.data)}, ": ")
            return DescribedNoise(noise.data, (no_frame, Clause(noise.reason.value)))
        described = describe_body(noise.body, noise.data, self._dialect, None)
        right = {"right": f"{checksum(noise.body):02X}"}
        wrong = Clause("checksum wrong, {right}h would be right; as it stands", right, ": ")
        clauses = (wrong, *described.clauses)
        return Described(described.uid, described.kind, described.fields, clauses, noise.data, False)


def describe_bytes(data: bytes, dialect: Dialect | None = None) -> list[Described | DescribedNoise]:
    """Whatever is in ``data``, in order."""
    dialect = dialect or Dialect()
    decoder = FrameDecoder(dialect)
    return Describer(dialect).describe([*decoder.feed(data), *decoder.flush()])


def describe_body(body: bytes, wire: bytes, dialect: Dialect, asked: Request | None = None) -> Described:
    """``body`` of a good frame; ``asked`` is the request it may answer."""
    if body[1] == ACK or body[1] == NAK:
        return _describe_answer(body, wire, dialect, asked)
    try:
        return _describe_request(parse_request(body, dialect), wire)
    except IllegalRequest as error:
        fields: dict[str, Json] = {"command": f"{body[1]:02X}", "data": body[2:].hex(" ").upper()}
        return Described(body[0], "unknown", fields, (_unit(body[0]), Clause(str(error))), wire)


def is_secret(request: Request) -> bool:
    """Whether the frames of this exchange carry a value that may not be shown or kept (#21)."""
    if not isinstance(request, ReadParameter | WriteParameter):
        return False
    return request.number in PARAMETERS and PARAMETERS[request.number].secret


# --- requests ------------------------------------------------------------------------------------


def _describe_request(request: Request, wire: bytes) -> Described:
    kind, _, told = _KINDS[request.COMMAND]
    to = Clause("all units", then=": ") if request.unit == 0 else _unit(request.unit)
    fields, values = _request_detail(request)
    return Described(request.unit, kind, fields, (to, Clause(told, values)), wire, request=request)


def _request_detail(request: Request) -> tuple[dict[str, Json], dict[str, int | str]]:
    """What it carries, for programs and for people."""
    match request:
        case ReadParameter(number=number):
            return {"number": number, "name": _name(number)}, {"parameter": _title(number)}
        case WriteParameter(number=number, raw=raw):
            shown = "hidden" if is_secret(request) else raw
            fields: dict[str, Json] = {"number": number, "name": _name(number), "raw": raw}
            return fields, {"parameter": _title(number), "raw": shown}
        case StageSpeed(raw=raw) | SetAndExecuteSpeed(raw=raw) | WriteAnalogOutput(raw=raw):
            return {"raw": raw}, {"raw": raw}
        case WriteOutput(output=output, on=on):
            return {"output": output, "on": on}, {"output": output, "state": "on" if on else "off"}
        case _:
            return {}, {}


def _unit(unit: int) -> Clause:
    return Clause("unit {unit}", {"unit": unit}, ": ")


def _name(number: int) -> str | None:
    return PARAMETERS[number].name if number in PARAMETERS else None


def _title(number: int) -> str:
    return f"#{number} {_name(number) or '(not in the list)'}"


# --- answers -------------------------------------------------------------------------------------


def _describe_answer(body: bytes, wire: bytes, dialect: Dialect, asked: Request | None) -> Described:
    reply = parse_reply(asked, body, dialect) if asked is not None else None
    if reply is not None and asked is not None:
        return _in_context(reply, asked, wire, dialect)
    return _without_context(body, wire, dialect)


def _in_context(reply: Reply, asked: Request, wire: bytes, dialect: Dialect) -> Described:
    match reply:
        case StatusReply():
            return _status(reply, wire, dialect)
        case Nak():
            return _nak(reply, wire, Clause("NAK to {command}", _command(asked), ", "))
        case ParameterReply() if isinstance(asked, ReadParameter):
            fields: dict[str, Json] = {"number": asked.number, "name": _name(asked.number), "raw": reply.raw}
            shown = "hidden" if is_secret(asked) else reply.raw
            value = Clause("{parameter} is {raw}", {"parameter": _title(asked.number), "raw": shown})
            return Described(reply.unit, "parameter_value", fields, (_unit(reply.unit), value), wire)
        case _:
            data = reply.data if isinstance(reply, Ack) else b""
            told = "took {command}, and said a value" if data else "took {command}"
            took = (_unit(reply.unit), Clause(told, _command(asked)))
            return Described(reply.unit, "ack", _data_fields(data), took, wire)


def _command(asked: Request) -> dict[str, int | str]:
    return {"command": _KINDS[asked.COMMAND][1]}


def _without_context(body: bytes, wire: bytes, dialect: Dialect) -> Described:
    unit, data = body[0], body[2:]
    if body[1] == NAK and len(data) == 1:
        return _nak(Nak(unit, data[0]), wire, Clause("NAK", then=", "))
    status = parse_reply(ReadStatus(unit), body, dialect)
    if isinstance(status, StatusReply):
        return _status(status, wire, dialect)
    kind, fields, told = _without_request(body[1], data)
    return Described(unit, kind, fields, (_unit(unit), told), wire)


def _without_request(mark: int, data: bytes) -> tuple[str, dict[str, Json], Clause]:
    if mark == ACK and not data:
        return "ack", {}, Clause("ACK, a write was taken")
    if mark == ACK and len(data) in _PARAMETER_VALUE_WIDTHS:
        told = (
            "ACK with {raw}: the value of a parameter, or the answer to a write of one;"
            " only the request would tell which"
        )
        fields = _data_fields(data)
        return "parameter_value", fields, Clause(told, {"raw": int.from_bytes(data, "big")})
    told = "{mark} with {count} bytes, which no answer has"
    values: dict[str, int | str] = {"mark": "ACK" if mark == ACK else "NAK", "count": len(data)}
    return "unknown", {"data": data.hex(" ").upper()}, Clause(told, values)


def _data_fields(data: bytes) -> dict[str, Json]:
    return {"raw": int.from_bytes(data, "big"), "width": len(data)} if data else {}


def _nak(reply: Nak, wire: bytes, nak: Clause) -> Described:
    name = unit_error_name(reply.code)
    fields: dict[str, Json] = {"unit_error": reply.code, "name": name}
    is_named = reply.code in set(UnitErrorCode)
    why = Clause(name) if is_named else Clause(UNNAMED_UNIT_ERROR, {"code": f"{reply.code:02X}"})
    return Described(reply.unit, "nak", fields, (_unit(reply.unit), nak, why), wire)


def _status(reply: StatusReply, wire: bytes, dialect: Dialect) -> Described:
    bits = status_bits(reply.outputs, reply.inputs, dialect.estop_healthy)
    fields: dict[str, Json] = {
        "commanded_raw": reply.commanded,
        "actual_raw": reply.actual,
        "analog_raw": reply.analog,
        "at_speed": bits.at_speed,
        "remote": bits.remote,
        "outputs": list(bits.outputs),
        "inputs": {**bits.inputs},
    }
    speeds = Clause(
        "commanded {commanded}, actual {actual}, analog {analog}",
        {"commanded": reply.commanded, "actual": reply.actual, "analog": reply.analog},
    )
    clauses = (_unit(reply.unit), *_listed([speeds, *_bits_in_words(bits)]))
    return Described(reply.unit, "status", fields, clauses, wire)


def _bits_in_words(bits: StatusBits) -> Iterator[Clause]:
    yield Clause("at speed" if bits.at_speed else "off speed")
    yield Clause("remote" if bits.remote else "not remote")
    for number, on in enumerate(bits.outputs, start=1):
        if on:
            yield Clause("output {output} on", {"output": number})
    names = {"estop": "emergency stop active", "slave": "follower"}
    yield from (Clause(names.get(name, name)) for name, on in bits.inputs.items() if on)


def _listed(clauses: list[Clause]) -> list[Clause]:
    *others, last = clauses
    return [*(replace(clause, then=", ") for clause in others), last]
