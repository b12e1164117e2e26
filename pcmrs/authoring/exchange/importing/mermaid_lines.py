"""The lines of a Mermaid state diagram as nested regions."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

from pcmrs.authoring.exchange.importing.reading import MAX_DEPTH, Findings
from pcmrs.fsm.finding import Place, refuse

NAME = r"(?:\[\*\]|[\w.-]+?)(?: ?:::\w+)?"
HEADER = re.compile(r"stateDiagram(-v2)?")
ARROW = re.compile(rf"(?P<source>{NAME}) ?--> ?(?P<target>{NAME}) ?(?::(?P<label>.*))?")
PSEUDO = re.compile(r"state (?P<name>\S+) ?(?:<<|\[\[)(?P<kind>\w+).*")
STATE = re.compile(rf'state (?:"(?P<text>[^"]*)" as )?(?P<name>{NAME}) ?(?P<open>\{{)?')
DESCRIPTION = re.compile(rf"(?P<name>{NAME}) ?: ?(?P<text>.*)")
NOTE = re.compile(r"note (?:left|right) of \S+ ?(?P<inline>:.*)?")
IGNORED = re.compile(r"(?:direction|classDef|class|style|click|accTitle|accDescr|scale|hide|title|linkStyle)\b.*")
ENTITY = re.compile(r"#(\d{1,6});")


@dataclass(frozen=True, slots=True)
class Arrow:
    """``source --> target : label``."""

    source: str
    target: str
    label: str
    place: Place


@dataclass(slots=True, eq=False)
class RegionLines:
    """What is said in one region of a composite state, or of the diagram.

    Attributes:
        place: Where it begins.
        named: States named in it, and where first.
        described: What some of them mean.
        composites: The regions of those that have some.
        arrows: In order.
    """

    place: Place
    named: dict[str, Place] = field(default_factory=dict)
    described: dict[str, str] = field(default_factory=dict)
    composites: dict[str, list[RegionLines]] = field(default_factory=dict)
    arrows: list[Arrow] = field(default_factory=list)


def read_lines(text: str, findings: Findings) -> list[RegionLines]:
    """The regions of a diagram.

    Args:
        text: The file.
        findings: Gets what is not supported.

    Raises:
        BlueprintError: It is no state diagram, its braces do not match, or it is too deep.
    """
    reader = _Lines(findings)
    lines = _statements(text)
    header, place = next(lines, ("", (1, 1)))
    if not HEADER.fullmatch(header):
        refuse(findings.origin, "not_mermaid", "A Mermaid state diagram begins with stateDiagram-v2.", place)
    for line, place in lines:
        reader.take(line, place)
    if len(reader.open) > 1:
        text = "This composite state is not closed: a } is missing."
        refuse(findings.origin, "not_mermaid", text, reader.open[-1][0].place)
    return reader.open[0]


def _statements(text: str) -> Iterator[tuple[str, Place]]:
    """Lines without comments, front matter and notes, in single spaces."""
    skipped_until = ""
    for number, line in enumerate(text.splitlines(), 1):
        words = " ".join(line.partition("%%")[0].split()).removesuffix(";").rstrip()
        if skipped_until:
            skipped_until = "" if words == skipped_until else skipped_until
        elif number == 1 and words == "---":
            skipped_until = "---"
        elif (note := NOTE.fullmatch(words)) or words == "accDescr {":
            skipped_until = ("" if note["inline"] else "end note") if note else "}"
        elif words:
            yield words, (number, len(line) - len(line.lstrip()) + 1)


class _Lines:
    """Takes statements; `open` has the regions of every composite state that is open, from the outermost."""

    def __init__(self, findings: Findings) -> None:
        self._findings = findings
        self.open: list[list[RegionLines]] = [[RegionLines((1, 1))]]

    def take(self, line: str, place: Place) -> None:
        region = self.open[-1][-1]
        if line == "}" and len(self.open) > 1:
            self.open.pop()
        elif line == "--":
            self.open[-1].append(RegionLines(place))
        elif arrow := ARROW.fullmatch(line):
            self._arrow(region, arrow, place)
        elif pseudo := PSEUDO.fullmatch(line):
            self._findings.say("not_supported", f"{pseudo['name']}: a {pseudo['kind']} is not supported.", place)
        elif state := STATE.fullmatch(line):
            self._state(region, state, place)
        elif IGNORED.fullmatch(line):
            return
        elif described := DESCRIPTION.fullmatch(line):
            name = self._name(region, described["name"], place)
            region.described[name] = _plain(described["text"])
        elif re.fullmatch(NAME, line):
            self._name(region, line, place)
        else:
            refuse(self._findings.origin, "not_mermaid", f"Not a line of a state diagram: {line[:60]!r}.", place)

    def _arrow(self, region: RegionLines, found: re.Match[str], place: Place) -> None:
        source, target = (self._name(region, found[end], place) for end in ("source", "target"))
        region.arrows.append(Arrow(source, target, _plain(found["label"] or ""), place))

    def _state(self, region: RegionLines, found: re.Match[str], place: Place) -> None:
        name = self._name(region, found["name"], place)
        if found["text"] is not None:
            region.described[name] = _plain(found["text"])
        if found["open"]:
            if len(self.open) > MAX_DEPTH:
                text = f"Composite states are nested over {MAX_DEPTH} deep."
                refuse(self._findings.origin, "too_deep", text, place)
            self.open.append(region.composites.setdefault(name, [RegionLines(place)]))

    def _name(self, region: RegionLines, word: str, place: Place) -> str:
        name = word.partition(":::")[0].strip()
        if name != "[*]":
            region.named.setdefault(name, place)
        return name


def _plain(text: str) -> str:
    """Text with its entity codes resolved."""
    return ENTITY.sub(lambda found: chr(min(int(found[1]), 0xFFFD)), text).strip()
