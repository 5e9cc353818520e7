"""Which column of a log may be which of a mission, by its name: for drafts and for advice, never used in silence."""

from __future__ import annotations

import re
from collections.abc import Sequence
from difflib import get_close_matches

from nls.missions.importing.units import BRACKET, dimension, header_unit, mission_unit

__all__ = ["guess", "guesses", "nearest", "plain"]

ABBREVIATIONS = {"fwd": "forward", "stbd": "starboard", "hdg": "heading", "bt": "bottom", "wt": "water"}
AXIS = r"(?:dvl|vel(?:ocity)?|v|speed|bottom|body|inst(?:rument)?|linear)"
PATTERNS: dict[str, tuple[str, ...]] = {  # by mission column, the best first; of names as `plain` makes them
    "time_s": (
        r"time",
        r"(?:time ?)?stamp",
        r"header stamp",
        r".*\b(?:time ?)?stamp",
        r"(?:utc|date ?time|epoch|t)",
        r".*\btime\b.*",
        r".*\bdate\b.*",
    ),
    "valid": (r".*\b(?:velocity|bottom|dvl)\b.*\b(?:valid|lock)", r".*\b(?:valid|lock|flag)"),
    "roll_rad": (r"roll", r".*\broll"),
    "pitch_rad": (r"pitch", r".*\bpitch"),
    "yaw_rad": (r"yaw", r"heading", r".*\b(?:true heading|heading true)", r".*\b(?:yaw|heading)"),
    "z_m": (r"depth", r".*\bdepth", r"altitude relative", r"altitude", r"height", r"z", r".*\bposition z"),
    "x_m": (r"x", r"north(?:ing)?", r".*\bposition x", r".*\bx", r"x odo\w*"),
    "y_m": (r"y", r"east(?:ing)?", r".*\bposition y", r".*\by", r"y odo\w*"),
    "lat_deg": (r"lat(?:itude)?", r".*\blat(?:itude)?"),
    "lon_deg": (r"lon(?:gitude)?|lng", r".*\b(?:lon(?:gitude)?|lng)"),
    "range_m": (r"(?:slant )?range", r"distance", r".*\b(?:range|distance).*"),
    "azimuth_rad": (r"azimuth", r"bearing", r".*\b(?:azimuth|bearing)"),
    "landmark": (r"(?:landmark|target|feature)(?: id)?",),
    "beacon": (r"(?:beacon|transponder)(?: id)?",),
    "sound_speed_m_s": (r".*sound.*(?:speed|velocity).*", r".*\bsvp?\b.*"),
}
VELOCITIES = {  # by column: its letter, its number, words in front and behind, another form
    "vx_m_s": ("x", 0, "surge|forward", "surge|forward", r".*\bu"),
    "vy_m_s": ("y", 1, "sway|starboard", "sway|starboard|port", rf"port {AXIS}"),
    "vz_m_s": ("z", 2, "heave", "heave|down|up", rf"(?:down|up) {AXIS}"),
}
PATTERNS |= {
    column: (
        *(rf".*\b{AXIS} ?(?:{letter}|{number})", rf"(?:{front})\b.*", rf".*\b{AXIS} (?:{behind})"),
        *(other, rf".*{AXIS}.*\b{letter}", rf".*\blinear {letter}"),
    )
    for column, (letter, number, front, behind, other) in VELOCITIES.items()
}
OTHER = {  # names that are something else: no velocity along own axes, no bottom lock
    "velocity": re.compile(r"\b(north|east|earth|local|ned|enu|map|world|imu|acc\w*|gyro|angular|water|air)\b"),
    "": re.compile(r"\b(gps|gnss|fix)\b"),
}
WISHED = re.compile(r"\b(c|cmd|command(?:ed)?|set ?point|desired|target|goal|way ?point|wpt)\b")  # last, if at all
WORLD = re.compile(rf"\b{AXIS} (?:north|east)|\b(?:north|east) {AXIS}")  # then down and up are of the world, too


def plain(name: str) -> str:
    """A header as words: without unit and signs, in lower case.

    Examples
    --------
    >>> plain("DVL X [m/s]"), plain("field.velocityInst0"), plain("v_mm_s"), plain("BT_Vel_Fwd")
    ('dvl x', 'field velocity inst 0', 'v', 'bottom vel forward')
    """
    unit, bracket = header_unit(name)
    text = BRACKET.sub("", name) if bracket else name
    if unit and not bracket:
        text = text[: -len(unit) - 1]
    text = re.sub(r"(?<=[a-z])(?=[A-Z0-9])", " ", text)
    words = re.findall(r"[a-z0-9]+", text.lower())
    return " ".join(ABBREVIATIONS.get(word, word) for word in words)


def guess(column: str, names: Sequence[str]) -> str | None:
    """The column of a log that is most likely a mission column; None where none looks like it.

    Examples
    --------
    >>> guess("vx_m_s", ["Time [s]", "DVL X [m/s]", "V East [m/s]"]), guess("z_m", ["Time [s]"])
    ('DVL X [m/s]', None)
    """
    return next(iter(guesses(column, names)), None)


def guesses(column: str, names: Sequence[str], taken: Sequence[str] = ()) -> list[str]:
    """All columns of a log that may be a mission column, the most likely first; what was commanded comes last."""
    kind = mission_unit(column)[0]
    fitting = [name for name in names if name not in taken and dimension(header_unit(name)[0]) in ("", kind)]
    if column == "valid" or kind == "velocity":
        fitting = [name for name in fitting if not OTHER[kind].search(plain(name))]
    if kind == "velocity" and any(WORLD.search(plain(name)) for name in names):
        fitting = [name for name in fitting if not {"down", "up"} & set(plain(name).split())]
    fitting.sort(key=lambda name: bool(WISHED.search(plain(name))))
    out = [column] if column in fitting else []
    out += [n for pattern in PATTERNS.get(column, ()) for n in fitting if re.fullmatch(pattern, plain(n))]
    return list(dict.fromkeys(out))


def nearest(column: str, name: str, names: Sequence[str]) -> str | None:
    """The column of a log that a misspelt name is closest to; else the one a mission column may be."""
    close = get_close_matches(name, names, 1)
    return close[0] if close else guess(column, names)
