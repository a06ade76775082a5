"""The execution of requests by the outstation. It handles requests and points, no sockets.

Every request is answered, but confirmations and the function without a response: what is wrong with it, the internal indications
(IIN) or the status of each point says (IEEE 1815, clauses 4.4 and 4.5).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from pytest_otmcp.wire.dnp3.application import (
    COLD_RESTART,
    DELAY_MEASURE,
    DIRECT_OPERATE,
    DIRECT_OPERATE_NR,
    DISABLE_UNSOLICITED,
    ENABLE_UNSOLICITED,
    OPERATE,
    READ,
    RECORD_CURRENT_TIME,
    SELECT,
    WRITE,
    Request,
)
from pytest_otmcp.wire.dnp3.objects import (
    ALL,
    COUNT8,
    COUNT16,
    FORMATS,
    INDEX8,
    INDEX16,
    OCTETS,
    START_STOP8,
    START_STOP16,
    Header,
    encode,
)

from .controls import operate, select
from .faults import Rule
from .plant import Event, Plant
from .points import Point, converted, fits, known, static_objects

__all__ = ["Answer", "Session", "execute", "unsolicited"]

NO_FUNCTION, OBJECT_UNKNOWN, PARAMETER_ERROR = 0x0100, 0x0200, 0x0400
"""IIN2.0, IIN2.1 and IIN2.2; the first octet of the indications is the lower one."""
_BROADCAST, _CLASS_1, _NEED_TIME, _LOCAL, _TROUBLE, _RESTART, _OVERFLOW = 0x01, 0x02, 0x10, 0x20, 0x40, 0x80, 0x0800

_RESPONSE, _UNSOLICITED_RESPONSE = 129, 130
_FIR_FIN, _CON, _UNS = 0xC0, 0x20, 0x10
_STATIC_GROUPS = (1, 10, 20, 30, 40)
"""Groups of class 0."""
_EVENTS = {2: "binary_input", 32: "analog_input"}
_EVENT_DEFAULTS = {2: 2, 32: 3}
_CLASSES = {2: 1, 3: 2, 4: 3}
"""Variations of group 60 to the classes of events."""
_LARGEST = 2000
"""Bytes of objects that fit into a fragment."""
_DELAY = bytes([52, 2, COUNT8, 1, 0, 0])


@dataclass(slots=True, kw_only=True)
class Session:
    """What the outstation remembers of one master's connection.

    Attributes:
        selected: objects, sequence number and time of the last request, where that was a successful SELECT.
        last: the last request and its answer: a master that misses an answer sends the request again, and that is the same request.
        unconfirmed: events of the responses that wait for their confirmation, by sequence number and whether they were unsolicited.
        classes: classes of which events are sent without being asked for.
        broadcast: a request to all outstations came since the last response.
    """

    selected: tuple[bytes, int, float] | None = None
    last: tuple[bytes, Answer] | None = None
    unconfirmed: dict[tuple[int, bool], Sequence[Event]] = field(default_factory=dict)
    classes: set[int] = field(default_factory=set)
    sequence: int = 0
    broadcast: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """A response.

    Attributes:
        iin: internal indications, the first octet in the lower byte.
        events: that it carries, so that it has to be confirmed.
    """

    sequence: int
    iin: int
    objects: bytes = b""
    events: Sequence[Event] = ()
    unsolicited: bool = False

    @property
    def confirm(self) -> bool:
        """Whether the master has to confirm it."""
        return bool(self.events) or self.unsolicited

    @property
    def function(self) -> int:
        """Function code."""
        return _UNSOLICITED_RESPONSE if self.unsolicited else _RESPONSE

    def encoded(self) -> bytes:
        """Return its fragment."""
        control = _FIR_FIN | _CON * self.confirm | _UNS * self.unsolicited | self.sequence
        return bytes([control, self.function]) + self.iin.to_bytes(2, "little") + self.objects


def execute(
    plant: Plant,
    session: Session,
    request: Request,
    rule: Rule | None,
    now: float,
    time_ms: int,
    told: Sequence[Event] = (),
) -> Answer:
    """Execute a request that is no confirmation, and return its answer.

    Args:
        now: monotonic time in seconds.
        time_ms: milliseconds since 1970.
        told: events that are being told unasked, which no answer tells beside.
    """
    selected, session.selected = session.selected, None
    objects, wrong, events = b"", 0, list[Event]()
    if rule is not None and rule.iin is not None:
        wrong = rule.iin
    elif request.problem is not None:
        wrong = OBJECT_UNKNOWN if request.unknown else PARAMETER_ERROR
    elif request.function == READ:
        objects, wrong, events = _read(plant, request.headers, time_ms, told)
    elif request.function == WRITE:
        wrong = _write(plant, request.headers, apply=rule is None or not rule.ack_only, time_ms=time_ms)
    elif request.function == SELECT:
        objects, wrong, chosen = select(plant, request.headers, rule)
        session.selected = (request.fragment[2:], request.sequence, now) if chosen else None
    elif request.function in (OPERATE, DIRECT_OPERATE, DIRECT_OPERATE_NR):
        missing = _not_selected(plant, request, selected, now) if request.function == OPERATE else 0
        objects, wrong = operate(plant, request.headers, rule, missing)
    elif request.function in (ENABLE_UNSOLICITED, DISABLE_UNSOLICITED):
        wrong = _enable(session, request)
    elif request.function in (COLD_RESTART, DELAY_MEASURE):
        objects = _DELAY
        plant.restarted = plant.restarted or request.function == COLD_RESTART
    elif request.function != RECORD_CURRENT_TIME:
        wrong = NO_FUNCTION
    iin = _indications(plant, session, events) | wrong | (0 if rule is None else rule.with_iin)
    session.broadcast = False
    return Answer(sequence=request.sequence, iin=iin, objects=objects, events=events)


def unsolicited(plant: Plant, session: Session, classes: set[int]) -> Answer:
    """Return a response that no request asked for, with what waits in these classes."""
    events = plant.waiting(classes)
    session.sequence = (session.sequence + 1) & 0x0F
    return Answer(
        sequence=session.sequence,
        iin=_indications(plant, session, events),
        objects=_event_objects(events, {}),
        events=events,
        unsolicited=True,
    )


def _indications(plant: Plant, session: Session, told: Sequence[Event]) -> int:
    """Return the indications of a response that carries some of the events."""
    left = {event.point.event_class for event in plant.events if all(event is not one for one in told)}
    flags = {
        _BROADCAST: session.broadcast,
        _NEED_TIME: plant.needs_time,
        _LOCAL: plant.local,
        _TROUBLE: plant.trouble,
        _RESTART: plant.restarted,
        _OVERFLOW: plant.overflowed,
    }
    return sum(bit for bit, is_set in flags.items() if is_set) | sum(_CLASS_1 << number - 1 for number in left)


def _not_selected(plant: Plant, request: Request, selected: tuple[bytes, int, float] | None, now: float) -> int:
    """Return the status of an OPERATE that no SELECT prepares (clause 4.4.3): 1 too late, 2 none; 0 where one does."""
    if selected is None:
        return 2
    objects, sequence, since = selected
    if objects != request.fragment[2:] or request.sequence != (sequence + 1) & 0x0F:
        return 2
    return 1 if now - since > plant.select_timeout_s else 0


def _enable(session: Session, request: Request) -> int:
    classes = {_CLASSES.get(header.variation, 0) for header in request.headers if header.group == 60}
    if not classes or 0 in classes or any(header.qualifier != ALL for header in request.headers):
        return PARAMETER_ERROR
    session.classes = session.classes | classes if request.function == ENABLE_UNSOLICITED else session.classes - classes
    return 0


# -- reading ----------------------------------------------------------------------------------------------------


def _read(
    plant: Plant, asked: Sequence[Header], time_ms: int, elsewhere: Sequence[Event]
) -> tuple[bytes, int, list[Event]]:
    objects, wrong, events = b"", 0, list[Event]()
    for header in asked:
        group, variation = header.group, header.variation
        if (group == 60 and variation in _CLASSES) or (group in _EVENTS and _event_known(group, variation)):
            if header.qualifier not in (ALL, COUNT8, COUNT16):
                wrong |= PARAMETER_ERROR
                continue
            classes = {_CLASSES[variation]} if group == 60 else {1, 2, 3}
            before = [*events, *elsewhere]
            told = [event for event in plant.waiting(classes) if all(event is not one for one in before)]
            if group != 60:
                told = [event for event in told if event.point.type == _EVENTS[group]]
            told = told[: header.count]
            objects += _event_objects(told, {group: variation} if group != 60 else {})
            events += told
        elif (group, variation) == (60, 1):
            objects += b"".join(static_objects(plant.of(one), 0) for one in _STATIC_GROUPS)
        elif (group, variation) == (50, 1):
            objects += bytes([50, 1, COUNT8, 1]) + time_ms.to_bytes(6, "little")
        elif known(group, variation):
            points, indexed = _wanted(plant, header)
            if points is None:
                wrong |= PARAMETER_ERROR
            else:
                objects += static_objects(points, 0 if group in OCTETS else variation, indexed)
        else:
            wrong |= OBJECT_UNKNOWN
    if len(objects) > _LARGEST:
        return b"", wrong | PARAMETER_ERROR, []
    return objects, wrong, events


def _wanted(plant: Plant, header: Header) -> tuple[Sequence[Point] | None, int | None]:
    """Return the points that a header of a read names, None if one of them is missing, and the qualifier for indexes."""
    every = plant.of(header.group)
    if header.qualifier == ALL:
        return every, None
    if header.qualifier in (START_STOP8, START_STOP16):
        assert header.start is not None
        assert header.stop is not None
        return (every[header.start : header.stop + 1] if header.stop < len(every) else None), None
    if header.qualifier in (INDEX8, INDEX16):
        indexes = [point["index"] for point in header.points]
        return (
            [every[index] for index in indexes] if all(index < len(every) for index in indexes) else None
        ), header.qualifier
    return every[: header.count], None


def _event_known(group: int, variation: int) -> bool:
    return variation == 0 or (group, variation) in FORMATS


def _event_objects(events: Sequence[Event], asked: dict[int, int]) -> bytes:
    """Return event objects in order; those of the same kind that follow each other share a header.

    Args:
        asked: variations by group, 0 and none for that of the outstation.
    """
    runs: list[tuple[int, int, list[bytes]]] = []
    for event in events:
        group = next(group for group, kind in _EVENTS.items() if kind == event.point.type)
        variation = asked.get(group, 0) or _EVENT_DEFAULTS[group]
        value, flags = converted(event.value, FORMATS[group, variation][1], event.flags)
        content = encode(group, variation, {"value": value, "flags": flags, "time_ms": event.time_ms})
        if not runs or runs[-1][:2] != (group, variation):
            runs.append((group, variation, []))
        runs[-1][2].append(event.point.index.to_bytes(2, "little") + content)
    return b"".join(
        bytes([group, variation, INDEX16]) + len(run).to_bytes(2, "little") + b"".join(run)
        for group, variation, run in runs
    )


# -- writing ----------------------------------------------------------------------------------------------------


def _write(plant: Plant, asked: Sequence[Header], *, apply: bool, time_ms: int) -> int:
    """Write the restart bit, the time or octet strings; all of them or, with an error, nothing."""
    strings: list[tuple[Point, bytes]] = []
    for header in asked:
        if header.group == 110:
            for point, content in zip(header.points, header.raw, strict=True):
                target = plant.points.get(f"octet_string/{point.get('index')}")
                if target is None or not fits("octets", content):
                    return PARAMETER_ERROR
                strings.append((target, content))
        elif (header.group, header.variation) == (80, 1):
            # Only the restart bit can be written, and only cleared (clause 4.5.8).
            if [*header.points] != [{"index": 7, "value": False}]:
                return PARAMETER_ERROR
        elif header.group != 50 or header.count != 1:
            return OBJECT_UNKNOWN
    if not asked:
        return PARAMETER_ERROR
    for header in asked if apply else ():
        if header.group == 80:
            plant.restarted = False
        elif header.group == 50:
            plant.needs_time = False
    for target, content in strings if apply else ():
        plant.hold(target, content, time_ms)
    return 0
