"""The explorer's page as Bokeh's documents, without a browser: what visitors do, and then see."""

from __future__ import annotations

import asyncio
import base64
import re
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any, NoReturn
from urllib.parse import parse_qsl

import numpy as np
import pytest

import polywigner as pw
from explorer_server import SECONDS, need_bokeh
from polywigner.explorer.computing import Scheduler
from polywigner.explorer.outlines import LARGEST_UPLOAD, rows_of_rings
from polywigner.explorer.readings import Readings
from polywigner.explorer.state import History, State, from_query, to_query

DIGITS = 1e-11  # relative: the page prints twelve
VISIBLE = [0]  # F alone: what is not asked about is not computed


@pytest.fixture(scope="module", autouse=True)
def bokeh(leave_out: Callable[[str], NoReturn]) -> None:
    """These tests are left out without the library of the page."""
    need_bokeh(leave_out)


class Visitor:
    """A page whose browser is the test: it sets models, and reads them."""

    def __init__(self, loop: Any, scheduler: Scheduler, query: str) -> None:
        from bokeh.document import Document

        from polywigner.explorer.page.session import open_page

        arguments = {name: [text.encode()] for name, text in parse_qsl(query)}
        self.context = SimpleNamespace(
            request=SimpleNamespace(arguments=arguments),
            session=SimpleNamespace(with_document_locked=lambda act: act()),
        )
        self.loop, self.doc = loop, Document()
        self.doc._session_context = lambda: self.context

        async def opened() -> Any:
            return open_page(self.doc, State(), scheduler, Readings())

        self.session = loop.run_until_complete(opened())

    def model(self, name: str) -> Any:
        return self.doc.get_model_by_name(name)

    def set(self, name: str, value: Any, attribute: str = "value") -> State:
        setattr(self.model(name), attribute, value)
        return self.settled()

    def text(self, name: str) -> str:
        return str(self.model(name).text)

    def click(self, name: str, wait: bool = True) -> State:
        from bokeh.events import ButtonClick

        button = self.model(name)
        button._trigger_event(ButtonClick(button))
        return self.settled() if wait else self.session.state

    def at(self, figure: str, x: float, y: float, kind: str = "Tap") -> State:
        from bokeh import events

        drawn = self.model(figure)
        drawn._trigger_event(getattr(events, kind)(drawn, x=x, y=y))
        return self.settled()

    def drag(self, rings: Any) -> None:
        """The vertices as a mouse has them now."""
        xs, ys = ([[p[k] for p in ring] for ring in rings] for k in (0, 1))
        self.model("outline").data = {"xs": xs, "ys": ys, "number": [*range(len(rings))]}

    def press(self, *keys: str, figure: str = "aperture", shift: bool = False) -> State:
        for key in keys:
            data = {"key": [key], "figure": [figure], "shift": [shift], "time": [0]}
            self.session.keys.data = data
        return self.settled()

    def send(self, name: str, content: bytes) -> State:
        upload = self.model("upload")
        upload.set_from_json("value", base64.b64encode(content).decode())
        upload.set_from_json("filename", name)
        return self.settled()

    def start(self, **fields: Any) -> State:
        """With another state and no past."""
        self.session.go(History(State(**fields)))
        return self.settled()

    def settled(self) -> State:
        """The state once nothing is on its way any more."""

        async def settle() -> None:
            for call in self.doc.session_callbacks:
                self.doc.remove_next_tick_callback(call)
                call.callback()
            while "computing" in self.text("busy") or self.session.reading:
                await asyncio.sleep(0.01)

        self.loop.run_until_complete(asyncio.wait_for(settle(), SECONDS))
        return from_query(self.model("link").value)

    def number(self, name: str) -> complex:
        """A value that the page prints, in m²."""
        match = re.search(rf"<td>{re.escape(name)}</td><td>(.*?) mm²", self.text("values"))
        assert match, self.text("values")
        parts = match[1].replace("− ", "-").replace("+ ", "+").removesuffix(" i").split()
        return complex(float(parts[0]), float(parts[1]) if len(parts) > 1 else 0.0) * 1e-6

    def picture(self, name: str) -> Any:
        """The values that a figure shows; None for none."""
        values = self.session.figures.images[name].source.data["value"]
        return values[0] if values else None


@pytest.fixture(scope="module")
def visits() -> Iterator[Callable[..., Visitor]]:
    """Opens the page of a link."""
    loop, scheduler = asyncio.new_event_loop(), Scheduler()
    asyncio.set_event_loop(loop)
    yield lambda query="", **fields: Visitor(
        loop, scheduler, query or (to_query(State(**fields)) if fields else "")
    )
    scheduler.stop()
    loop.close()


@pytest.fixture(scope="module")
def opened(visits: Callable[..., Visitor]) -> Visitor:
    return visits()


@pytest.fixture
def page(opened: Visitor) -> Visitor:
    """A page as it is at first: to make another one takes a third of a second."""
    opened.model("take").value = "wigner_nu"
    opened.set("draw", False, "active")
    opened.model("views").active = VISIBLE
    opened.start()
    return opened


def test_the_page_opens_with_a_square_and_its_numbers(page: Visitor) -> None:
    assert page.settled() == State()
    assert page.text("message") == "" and "ready" in page.text("busy")
    assert np.isclose(page.number("∫|u|² dx"), 1e-4, rtol=DIGITS)


def test_an_outline_is_drawn_corner_by_corner(page: Visitor) -> None:
    page.set("snap", 0.5)
    page.set("shape", "blank sheet")
    assert "blank" in page.text("message") and page.model("draw").active
    assert "nothing drawn" in page.text("busy") and page.picture("fourier") is None
    page.at("aperture", 2.4, 2.4)
    page.press("Escape", figure="")  # gives up
    assert not page.model("draw").active and page.settled().rings == ()
    page.set("draw", True, "active")
    corners = ((-3.0, -2.0), (3.0, -2.0), (0.0, 3.0))
    for x, y in (*corners, corners[0]):
        page.at("aperture", x + 0.05, y - 0.1)
    assert page.settled().rings == (corners,)
    page.at("aperture", 0.5, 0.5)
    state = page.at("fourier", 0.05, 0.02)
    assert np.allclose(state.nu, (0.05, 0.02), atol=0.01) and state.x == (0.5, 0.5)
    source = pw.Aperture(np.array(corners) / 1000)
    x, nu = np.array(state.x) / 1000, np.array(state.nu) * 1000
    assert np.isclose(page.number("F(ν)"), pw.fourier(source, nu), rtol=DIGITS)
    assert np.isclose(page.number("W(x, ν)"), pw.wigner(source, x, nu), rtol=DIGITS)


def test_a_drag_follows_the_hand_and_is_one_step_of_undo(page: Visitor) -> None:
    before = page.settled().rings
    page.at("aperture", 5.0, 5.0, "PanStart")
    for x in (5.51234, 6.0):
        page.drag(((*before[0][:2], (x, x), before[0][3]),))
        assert np.allclose(page.settled().rings[0][2], x, atol=0.05)
    moved = page.at("aperture", 6.0, 6.0, "PanEnd").rings
    assert len(page.at("aperture", 0.0, -5.0, "DoubleTap").rings[0]) == 5
    assert page.click("undo").rings == moved
    assert page.press("undo", figure="").rings == before
    assert page.press("redo", figure="").rings == moved
    rows = list(zip(*(page.model("rows").data[k] for k in ("ring", "x", "y")), strict=True))
    assert rows == rows_of_rings(moved)


def test_a_hole_does_not_outlive_its_outline(page: Visitor) -> None:
    rings = (((-6.0, -6.0), (6.0, -6.0), (0.0, 6.0)), ((-1.0, -3.0), (1.0, -3.0), (0.0, 0.0)))
    page.start(rings=rings)
    for delete in (
        lambda: page.press("Delete"),
        lambda: page.drag((rings[0][1:], rings[1])),  # Backspace is of Bokeh's tool
        lambda: page.click("delete"),
    ):
        page.session.figures.aperture.choose(1)
        delete()
        assert page.settled().rings == ()
        assert "Outline 1 had" in page.text("message") and "outline 2" in page.text("message")
        assert page.picture("fourier") is None
        assert page.click("undo").rings == rings and page.picture("fourier") is not None


def test_many_vertices_have_fewer_handles_and_all_can_be_reached(page: Visitor) -> None:
    turns = 2 * np.pi * np.arange(240) / 240
    ring = tuple((round(5 * np.cos(t), 6), round(5 * np.sin(t), 6)) for t in turns)
    page.start(rings=(ring,))
    assert "120 handles, 240 vertices" in page.model("aperture").title.text
    page.press("n", "n")  # the second has no handle
    assert page.model("vertices").data["handle"][:4] == ["yes", "yes", "yes", ""]
    moved = page.press("ArrowUp").rings[0]
    assert [k for k in range(240) if moved[k] != ring[k]] == [1]


def test_a_vertex_is_chosen_moved_added_and_deleted_by_keys(page: Visitor) -> None:
    before = page.settled().rings
    page.press("n", "ArrowUp", "ArrowUp")
    assert "Vertex 1 of 4: (-5, -4.8) mm" in page.text("message")
    assert page.press("Insert").rings[0][:2] == ((-5, -4.8), (0, -4.9))
    assert len(page.press("Delete").rings[0]) == 4
    for _ in range(3):  # moves of one vertex that follow each other are one step
        page.click("undo")
    assert page.settled().rings == before
    page.press("Escape")
    assert page.press("ArrowRight", shift=True).x == (1.0, 0.0)
    assert page.press("ArrowRight", figure="fourier").nu[0] > 0
    page.click("insert")
    assert "Select a vertex" in page.text("message")
    page.model("rows").selected.indices = [3]
    assert page.click("insert").rings[0][4] == (-5, 0)


def test_a_crossing_outline_says_so_and_the_last_good_result_stays(page: Visitor) -> None:
    image, values = page.picture("fourier"), page.text("values")
    page.set("rows", {"ring": [1] * 4, "x": [-5, 5, -5, 5], "y": [-5, -5, 5, 5]}, "data")
    assert "crosses itself" in page.text("message") and "earlier state" in page.text("busy")
    assert "fourier" in page.model("stale").data["figure"]
    assert page.text("values") == values and page.picture("fourier") is image
    page.click("undo")
    assert page.text("message") == "" and page.model("stale").data["figure"] == []


def test_a_value_that_is_none_is_refused_with_a_message_and_the_old_one_is_back(
    page: Visitor,
) -> None:
    assert page.set("wave", "ten") == State()
    assert "94 GHz" in page.text("message") and page.model("wave").value == "94 GHz"
    assert page.set("taper", "gaussian").taper == "gaussian"
    assert "taper" in page.text("message")


def test_a_slider_moves_its_view_and_no_other_number(page: Visitor) -> None:
    values = page.text("values")
    assert page.set("defocus", 0.15).defocus == 0.15
    assert page.text("values") == values and not page.session.history.past
    assert page.set("coherence", 5.0).coherence == 5.0 and page.text("message") == ""


def test_good_and_bad_files_can_be_sent(page: Visitor) -> None:
    good = b"POLYGON((0 0, 4 0, 4 2, 0 2, 0 0))"
    assert page.send("outline.wkt", good).rings[0][0] == (4, 0)
    assert np.isclose(page.number("∫|u|² dx"), 8e-6, rtol=DIGITS)
    page.send("broken.geojson", b"{ not json")
    assert "broken.geojson" in page.text("message")
    assert "Traceback" not in page.text("message") and "tmp" not in page.text("message")
    page.session.refused.data = {"name": ["a.wkt"], "size": [8 * LARGEST_UPLOAD], "time": [1]}
    assert "8.0 MiB" in page.text("message")
    assert page.send("outline.wkt", good).rings[0][0] == (4, 0) and page.text("message") == ""


def test_a_link_restores_the_page_and_a_damaged_one_says_so(visits: Callable[..., Visitor]) -> None:
    fields = {"taper": "cosine", "x": (1.0, 2.0), "nu": (0.03, 0.0), "defocus": 0.5, "unit": "cm"}
    assert visits(**fields).settled() == State(**fields)
    page = visits("unit=furlong")
    assert "furlong" in page.text("message") and page.settled() == State()


def test_lengths_are_in_one_unit_and_colour_bars_keep_their_powers_of_ten(page: Visitor) -> None:
    ring = tuple((1e-3 * x, 1e-3 * y) for x, y in State().rings[0])
    page.model("views").active = [0, 2]
    page.start(unit="m", rings=(ring,))
    assert "<td>0.0001 m²</td>" in page.text("values")
    assert page.model("wigner_x").title.text == "W(x, ν) over x (10⁻⁶ m²)"
    assert "10⁻⁹ m⁴" in page.model("fourier").title.text
    high = page.session.figures.images["wigner_x"].mapper.high
    assert np.isclose(high, 400, rtol=1e-2)  # 4e-4 m²


def test_the_snippet_of_the_page_has_the_numbers_of_its_picture(page: Visitor) -> None:
    page.set("views", [2], "active")
    page.set("array", "2 x 1, 12 mm")
    page.set("x", 6.0)
    page.set("take", "wigner_x")
    page.click("take_py")
    page.loop.run_until_complete(asyncio.sleep(0.1))
    sent = page.session.downloads.data
    script = base64.b64decode(sent["content"][0]).decode()
    assert sent["name"] == ["wigner_x.py"] and script == page.model("code").value
    namespace: dict[str, Any] = {}
    exec(script, namespace)
    drawn = page.picture("wigner_x")
    scale = np.abs(drawn).max()
    assert np.allclose(drawn, namespace["values"] * 1e6, rtol=1e-6, atol=1e-6 * scale)  # float32
    here = pw.wigner(namespace["source"], (6e-3, 0.0), (0.0, 0.0))
    assert np.isclose(page.number("W(x, ν)"), here, rtol=DIGITS)


def test_the_tour_shows_what_it_speaks_of_and_no_picture_of_another_source(page: Visitor) -> None:
    async def picture() -> None:
        while page.picture("rays_near") is None:
            await asyncio.sleep(0.01)

    async def changed() -> None:
        while page.text("values") == values:
            await asyncio.sleep(0.01)

    for step in range(1, 6):
        page.click("tour_next", wait=False)
        assert f"{step} of 5" in page.text("tour")
    assert page.model("rays_near").visible
    page.loop.run_until_complete(asyncio.wait_for(picture(), SECONDS))
    assert "computing near field, " in page.text("busy")  # what is finer takes seconds
    values = page.text("values")
    page.model("x").value = 0.5  # and keeps nobody waiting
    page.loop.run_until_complete(asyncio.wait_for(changed(), SECONDS))
    page.set("array", "4 x 4, 12 mm")  # has too many edges for rays
    assert "near field: expected" in page.text("message")
    assert page.picture("rays_near") is None  # not the picture of the last source
    page.click("tour_next")  # the end
    assert page.text("tour") == "" and page.model("views").active == VISIBLE


def test_a_visitor_who_leaves_is_computed_for_no_more(visits: Callable[..., Visitor]) -> None:
    page, other = visits(), visits(steering="10 deg")
    page.session.leave()
    said = page.text("busy")
    assert other.set("views", VISIBLE, "active").steering == "10 deg"
    assert page.text("busy") == said and page.picture("fourier") is None
