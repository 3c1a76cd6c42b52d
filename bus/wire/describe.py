"""What frames say, in words for people and as fields for programs (``lineside decode``, the trace).

Field names are those of the HTTP API (contract): ``raw`` is the integer on the wire. An answer names
neither its command nor its parameter; where the request is not at hand the words say what is open.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TypeAlias

from bus.catalogue.parameters import PARAMETERS
from bus.catalogue.status import StatusBits, status_bits
from bus.errors import unit_error_name
from bus.settings import Dialect
from bus.wire.commands import (
    Ack,
    IllegalRequest,
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
    parse_reply,
    parse_request,
)
from bus.wire.framing import ACK, NAK, FrameDecoder, Noise, Received, ReceivedFrame, checksum

Json: TypeAlias = "bool | int | str | list[Json] | dict[str, Json] | None"

_KINDS = {
    0x81: ("read_status", "read speed and status"),
    0x82: ("set_speed", "set speed (staged)"),
    0x83: ("execute_speed", "execute speed"),
    0x84: ("set_and_execute_speed", "set and execute speed"),
    0x85: ("read_parameter", "read parameter"),
    0x86: ("write_parameter", "write parameter"),
    0x87: ("write_output", "write auxiliary output"),
    0x88: ("write_analog_output", "write analog output"),
}
_PARAMETER_VALUE_WIDTHS = (1, 2, 4)


@dataclass(frozen=True, slots=True)
class Described:
    """One frame, or a frame whole but for its checksum. ``words`` never show a secret, ``fields`` do."""

    uid: int
    kind: str
    fields: dict[str, Json]
    words: str
    wire: bytes
    checksum_ok: bool = True
    request: Request | None = None
    """What it asks, where it is a request."""

    def as_json(self) -> dict[str, Json]:
        """The object of ``lineside decode --json``."""
        return {
            "uid": self.uid,
            "kind": self.kind,
            "fields": self.fields,
            "checksum_ok": self.checksum_ok,
        }


@dataclass(frozen=True, slots=True)
class Rubbish:
    """Bytes that are no frame."""

    wire: bytes
    words: str


class Describer:
    """Frames in their order, so that an answer is read in the light of the request before it."""

    def __init__(self, dialect: Dialect) -> None:
        self._dialect = dialect
        self._asked: Request | None = None

    def describe(self, received: Iterable[Received]) -> list[Described | Rubbish]:
        """Everything but the doubled checksum bytes, which belong to the frames before them."""
        described: list[Described | Rubbish] = []
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

    def _noise(self, noise: Noise) -> Described | Rubbish:
        if not noise.body:
            return Rubbish(noise.data, f"{len(noise.data)} bytes that are no frame: {noise.reason}")
        described = describe_body(noise.body, noise.data, self._dialect, None)
        right = f"checksum wrong, {checksum(noise.body):02X}h would be right; as it stands: "
        return Described(
            described.uid, described.kind, described.fields, right + described.words, noise.data, False
        )


def describe_bytes(data: bytes, dialect: Dialect | None = None) -> list[Described | Rubbish]:
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
        return Described(body[0], "unknown", fields, f"unit {body[0]}: {error}", wire)


def is_secret(request: Request) -> bool:
    """Whether the frames of this exchange carry a value that may not be shown or kept (#21)."""
    if not isinstance(request, ReadParameter | WriteParameter):
        return False
    return request.number in PARAMETERS and PARAMETERS[request.number].secret


# --- requests ------------------------------------------------------------------------------------


def _describe_request(request: Request, wire: bytes) -> Described:
    kind, name = _KINDS[request.COMMAND]
    to = "all units" if request.unit == 0 else f"unit {request.unit}"
    fields, detail = _request_detail(request)
    return Described(request.unit, kind, fields, f"{to}: {name}{detail}", wire, request=request)


def _request_detail(request: Request) -> tuple[dict[str, Json], str]:
    match request:
        case ReadParameter(number=number):
            return {"number": number, "name": _name(number)}, f" {_title(number)}"
        case WriteParameter(number=number, raw=raw):
            shown = "hidden" if is_secret(request) else raw
            return {"number": number, "name": _name(number), "raw": raw}, f" {_title(number)} = {shown}"
        case StageSpeed(raw=raw) | SetAndExecuteSpeed(raw=raw) | WriteAnalogOutput(raw=raw):
            return {"raw": raw}, f" {raw}"
        case WriteOutput(output=output, on=on):
            return {"output": output, "on": on}, f" {output} {'on' if on else 'off'}"
        case _:
            return {}, ""


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
    command = _KINDS[asked.COMMAND][1]
    match reply:
        case StatusReply():
            return _status(reply, wire, dialect)
        case Nak():
            return _nak(reply, wire, f" to {command}")
        case ParameterReply() if isinstance(asked, ReadParameter):
            fields: dict[str, Json] = {"number": asked.number, "name": _name(asked.number), "raw": reply.raw}
            shown = "hidden" if is_secret(asked) else reply.raw
            words = f"unit {reply.unit}: {_title(asked.number)} is {shown}"
            return Described(reply.unit, "parameter_value", fields, words, wire)
        case _:
            data = reply.data if isinstance(reply, Ack) else b""
            said = ", and said a value" if data else ""
            return Described(
                reply.unit, "ack", _data_fields(data), f"unit {reply.unit}: took {command}{said}", wire
            )


def _without_context(body: bytes, wire: bytes, dialect: Dialect) -> Described:
    unit, data = body[0], body[2:]
    if body[1] == NAK and len(data) == 1:
        return _nak(Nak(unit, data[0]), wire, "")
    status = parse_reply(ReadStatus(unit), body, dialect)
    if isinstance(status, StatusReply):
        return _status(status, wire, dialect)
    if body[1] == ACK and not data:
        return Described(unit, "ack", {}, f"unit {unit}: ACK, a write was taken", wire)
    if body[1] == ACK and len(data) in _PARAMETER_VALUE_WIDTHS:
        words = (
            f"unit {unit}: ACK with {int.from_bytes(data, 'big')}: the value of a parameter, or the answer"
            " to a write of one; only the request would tell which"
        )
        return Described(unit, "parameter_value", _data_fields(data), words, wire)
    mark = "ACK" if body[1] == ACK else "NAK"
    words = f"unit {unit}: {mark} with {len(data)} bytes, which no answer has"
    return Described(unit, "unknown", {"data": data.hex(" ").upper()}, words, wire)


def _data_fields(data: bytes) -> dict[str, Json]:
    return {"raw": int.from_bytes(data, "big"), "width": len(data)} if data else {}


def _nak(reply: Nak, wire: bytes, what: str) -> Described:
    name = unit_error_name(reply.code)
    fields: dict[str, Json] = {"unit_error": reply.code, "name": name}
    return Described(reply.unit, "nak", fields, f"unit {reply.unit}: NAK{what}, {name}", wire)


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
    words = f"unit {reply.unit}: commanded {reply.commanded}, actual {reply.actual}, analog {reply.analog}, "
    return Described(reply.unit, "status", fields, words + ", ".join(_bits_in_words(bits)), wire)


def _bits_in_words(bits: StatusBits) -> list[str]:
    words = ["at speed" if bits.at_speed else "off speed", "remote" if bits.remote else "not remote"]
    words += [f"output {number} on" for number, on in enumerate(bits.outputs, start=1) if on]
    names = {"estop": "emergency stop active", "slave": "follower"}
    return words + [names.get(name, name) for name, on in bits.inputs.items() if on]
