"""Random state charts, and how they are written in each notation that is imported."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from random import Random
from urllib.parse import quote

EVENTS = ("e0", "e1", "e2", "e3.sub", "e3", "e4", "e5", "e6", "e7", "e8", "e9")


@dataclass
class Drawn:
    """One state: its kind is that of the SCXML element, its arrows are events, target and type."""

    kind: str
    id: str
    events: list[str]
    initial: str = ""
    children: list[Drawn] = field(default_factory=list)
    arrows: list[tuple[list[str], str, str]] = field(default_factory=list)

    def walk(self) -> Iterator[Drawn]:
        yield self
        for child in self.children:
            yield from child.walk()


def random_chart(rng: Random, *, plain: bool = False) -> Drawn:
    """The root of a chart.

    Final states are not put into parallel ones: the peer ends when all regions of the outermost are final, which
    SCXML does not. It also takes states before finals and parallels: where that matters, the initial is said.

    Args:
        rng: Where it comes from; the same generator gives the same chart.
        plain: Only what all notations can say.
    """
    root = Drawn("scxml", "", list(EVENTS))
    maker = _Maker(rng, root, plain)
    root.children = [maker.shape(1, root, parallel=False) for _ in range(rng.randint(1, 4))]
    maker.start(root)
    for node in root.walk():
        for child in node.children:
            maker.draw_arrows(child, node)
    return root


@dataclass
class _Maker:
    rng: Random
    root: Drawn
    plain: bool
    count: int = 0

    def shape(self, depth: int, above: Drawn, *, parallel: bool) -> Drawn:
        rng, draw = self.rng, self.rng.random()
        self.count += 1
        own = above.kind == "parallel" and rng.random() < 0.8
        events = rng.sample(above.events, min(3, len(above.events))) if own else above.events
        node = Drawn("state", f"s{self.count}", events)
        region = above.kind == "parallel" and self.plain
        if depth >= 5 or (draw < 0.5 and not region) or (depth >= 4 and not region):
            node.kind = "final" if not self.plain and not parallel and draw < 0.04 else "state"
            return node
        node.kind = "parallel" if draw > 0.8 and not region else "state"
        inner = parallel or node.kind == "parallel"
        least = 2 if self.plain and node.kind == "parallel" else 1
        node.children = [self.shape(depth + 1, node, parallel=inner) for _ in range(rng.randint(least, 3))]
        self.start(node)
        return node

    def start(self, node: Drawn) -> None:
        first_is_plain = bool(node.children) and node.children[0].kind == "state" and not self.plain
        if node.children and node.kind != "parallel" and not (first_is_plain and self.rng.random() < 0.5):
            node.initial = self.rng.choice(node.children).id

    def draw_arrows(self, node: Drawn, above: Drawn) -> None:
        if node.kind == "final" or (self.plain and above.kind == "parallel"):
            return
        node.arrows = [self.arrow(node, above) for _ in range(self.rng.choice([1, 2, 3, 3, 4]))]

    def arrow(self, node: Drawn, above: Drawn) -> tuple[list[str], str, str]:
        rng = self.rng
        events = rng.sample(node.events, min(len(node.events), rng.choice([1, 1, 1, 2])))
        inside = [inner.id for inner in node.walk() if inner is not node]
        if not self.plain and inside and node.kind == "state" and rng.random() < 0.2:
            return events, rng.choice(inside), "internal"
        near = [sibling.id for sibling in above.children] if above.kind != "parallel" else [node.id]
        if self.plain:
            return events, rng.choice(near), ""
        everywhere = [inner.id for inner in self.root.walk() if inner is not self.root]
        target = "" if rng.random() < 0.1 else rng.choice(near if rng.random() < 0.8 else everywhere)
        return events, target, ""


def as_scxml(node: Drawn, *, element: bool = False) -> str:
    """The chart in SCXML; initials as elements instead of attributes if asked for."""
    inside = "".join(as_scxml(child, element=not element) for child in node.children)
    arrows = ""
    for events, target, kind in node.arrows:
        to = f' target="{target}"' if target else ""
        how = f' type="{kind}"' if kind else ""
        arrows += f'<transition event="{" ".join(events)}"{to}{how}/>'
    initial = f' initial="{node.initial}"' if node.initial else ""
    if node.kind == "scxml":
        return f'<scxml xmlns="http://www.w3.org/2005/07/scxml" version="1.0"{initial}>{inside}</scxml>'
    if initial and element:
        initial, arrows = "", f'<initial><transition target="{node.initial}"/></initial>{arrows}'
    return f'<{node.kind} id="{node.id}"{initial}>{arrows}{inside}</{node.kind}>'


def as_mermaid(root: Drawn) -> str:
    """A plain chart in Mermaid."""
    return "\n".join(["stateDiagram-v2", *_mermaid(root)])


def _mermaid(node: Drawn) -> Iterator[str]:
    for number, child in enumerate(node.children):
        if node.kind == "parallel" and number:
            yield "--"
        yield f"state {child.id}" + (" {" if child.children else "")
        if child.children:
            yield from _mermaid(child)
            yield "}"
    if node.initial:
        yield f"[*] --> {node.initial}"
    for child in node.children:
        for events, target, _ in child.arrows:
            yield f"{child.id} --> {target} : {', '.join(events)}"


def as_drawio(root: Drawn, *, compressed: bool) -> str:
    """A plain chart as a draw.io file."""
    cells = ['<mxCell id="0"/>', '<mxCell id="cell-" parent="0"/>', *_drawio(root)]
    model = f"<mxGraphModel><root>{''.join(cells)}</root></mxGraphModel>"
    return f'<mxfile><diagram name="Page-1">{packed(model.encode()) if compressed else model}</diagram></mxfile>'


def packed(raw: bytes) -> str:
    """A diagram as draw.io compresses it."""
    return deflated(quote(raw).encode())


def deflated(quoted: bytes) -> str:
    """The last two steps of draw.io's compression, of a diagram that is quoted already."""
    deflate = zlib.compressobj(9, zlib.DEFLATED, -15)
    return base64.b64encode(deflate.compress(quoted) + deflate.flush()).decode()


def _drawio(node: Drawn) -> Iterator[str]:
    parent = f'parent="cell-{node.id}"'
    for child in node.children:
        style = "swimlane;html=1" if child.children else "rounded=1;html=1"
        label = f"&lt;b&gt;{child.id}&lt;/b&gt;"
        yield f'<mxCell id="cell-{child.id}" value="{label}" style="{style}" vertex="1" {parent}/>'
        yield from _drawio(child)
    if node.initial:
        yield f'<mxCell id="start-{node.id}" style="ellipse;fillColor=#000" vertex="1" {parent}/>'
        yield f'<mxCell id="first-{node.id}" edge="1" source="start-{node.id}" target="cell-{node.initial}" {parent}/>'
    for child in node.children:
        for number, (events, target, _) in enumerate(child.arrows):
            ends = f'source="cell-{child.id}" target="cell-{target}"'
            yield f'<mxCell id="e{number}-{child.id}" value="{", ".join(events)}" edge="1" {ends} {parent}/>'


def flat(count: int, event: str, target: str) -> str:
    """Numbered states with a transition each."""
    return "".join(
        f'<state id="s{i}"><transition event="{event.format(i)}" target="{target.format((i + 1) % count)}"/></state>'
        for i in range(count)
    )
