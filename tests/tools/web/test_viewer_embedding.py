"""The viewer as an element of a page that scrolls, on a desktop and on a phone."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import pytest
from chromium import wait_until
from faulty_server import FaultyServer
from running import SmallScene

if TYPE_CHECKING:
    from playwright.sync_api import Browser, CDPSession, Page

sync_api = pytest.importorskip("playwright.sync_api", reason="needs playwright")
expect = sync_api.expect

pytestmark = pytest.mark.slow

COMPLETE = "s.state === 'complete' && s.upToDate"
DESKTOP = {"width": 900, "height": 700}
PHONE = {"width": 390, "height": 700}
PAGE = """<!doctype html><html lang="en"><meta name="viewport" content="width=device-width">
<title>A page</title><style>body {{ margin: 0 20px }} {style}</style>
<script type="module" src="viewer.js"></script>
<p style="height: {before}px">Text</p>
<cogsplat-viewer {attributes}></cogsplat-viewer>
<p style="height: 3000px">More text</p></html>"""


def embed(server: FaultyServer, attributes: str, style: str = "", before: int = 40) -> str:
    """Serve a page with the element, and return its URL."""
    page = PAGE.format(attributes=attributes, style=style, before=before)
    server.files["embed.html"] = page.encode()
    return f"{server.url}embed.html"


@contextmanager
def opened(
    browser: Browser, url: str, *, phone: bool = False, calm: bool = False
) -> Iterator[Page]:
    """Open a page whose element the tests find as ``cogsplatViewer``; it must not throw."""
    context = browser.new_context(
        viewport=PHONE if phone else DESKTOP,
        has_touch=phone,
        is_mobile=phone,
        reduced_motion="reduce" if calm else "no-preference",
    )
    page = context.new_page()
    thrown: list[str] = []
    page.on("pageerror", lambda error: thrown.append(str(error)))
    page.goto(url)
    page.evaluate("() => { window.cogsplatViewer ??= document.querySelector('cogsplat-viewer'); }")
    yield page
    context.close()
    assert thrown == []


def scrolled(page: Page, least: int = 1) -> None:
    page.wait_for_function(f"() => scrollY >= {least}")


def pose(page: Page) -> str:
    return str(page.evaluate("() => JSON.stringify(cogsplatViewer.view)"))


def drag(session: CDPSession, *fingers: tuple[int, int], by: tuple[int, int]) -> None:
    """Touch the screen with each finger in turn, then move all fingers together."""

    def send(kind: str, share: float, count: int) -> None:
        points = [
            {"x": x + share * by[0], "y": y + share * by[1], "id": i}
            for i, (x, y) in enumerate(fingers[:count])
        ]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    for count in range(1, len(fingers) + 1):
        send("touchStart", 0, count)
    for step in range(1, 9):
        send("touchMove", step / 8, len(fingers))
    send("touchEnd", 1, 0)


def test_the_wheel_scrolls_the_page_until_a_click(browser: Browser, server: FaultyServer) -> None:
    url = embed(server, 'src="scene.cogs"', "cogsplat-viewer { height: 300px }")
    with opened(browser, url) as page:
        wait_until(page, COMPLETE)
        # A height narrows the element no more than the page does.
        assert page.locator("cogsplat-viewer").evaluate("(it) => it.clientWidth") == 860
        first = pose(page)
        page.mouse.move(450, 250)
        page.mouse.wheel(0, 200)
        scrolled(page, 200)
        expect(page.get_by_text("hold Ctrl, to zoom")).to_be_visible()
        assert pose(page) == first
        page.evaluate("() => scrollTo(0, 0)")
        page.mouse.click(450, 250)
        page.mouse.wheel(0, 200)
        wait_until(page, f"JSON.stringify(cogsplatViewer.view) !== {first!r}")
        assert page.evaluate("() => scrollY") == 0
        # A full screen viewer has all gestures; so has one that asks for them.
        page.mouse.click(450, 30)
        page.locator("cogsplat-viewer").evaluate("(it) => it.setAttribute('gestures', 'all')")
        first = pose(page)
        page.mouse.move(450, 250)
        page.mouse.wheel(0, 200)
        wait_until(page, f"JSON.stringify(cogsplatViewer.view) !== {first!r}")
        assert page.evaluate("() => scrollY") == 0


def test_one_finger_scrolls_the_page_and_two_turn_the_scene(
    browser: Browser, server: FaultyServer
) -> None:
    url = embed(server, 'src="scene.cogs"', "cogsplat-viewer { height: 300px }")
    with opened(browser, url, phone=True) as page:
        wait_until(page, COMPLETE)
        session = page.context.new_cdp_session(page)
        first = pose(page)
        drag(session, (200, 250), by=(0, -120))
        scrolled(page)
        expect(page.get_by_text("Two fingers turn the scene")).to_be_visible()
        assert pose(page) == first
        # A page goes on scrolling for a while after the finger has left it.
        page.wait_for_function(
            "() => { const before = globalThis.before; globalThis.before = scrollY;"
            " return before === scrollY; }",
            polling=500,
        )
        page.evaluate("() => scrollTo(0, 0)")
        page.wait_for_function("() => scrollY === 0")
        drag(session, (150, 200), (250, 200), by=(80, 40))
        wait_until(page, f"JSON.stringify(cogsplatViewer.view) !== {first!r}")
        assert page.evaluate("() => scrollY") == 0


def test_a_lazy_element_fetches_nothing_before_it_is_seen(
    browser: Browser, server: FaultyServer
) -> None:
    url = embed(server, 'src="scene.cogs" lazy', before=2000)
    with opened(browser, url) as page:
        page.wait_for_timeout(500)
        assert server.traffic.size_bytes("scene.cogs") == 0
        page.evaluate("() => scrollTo(0, 1900)")
        wait_until(page, COMPLETE)


def test_a_poster_stands_until_the_first_picture(
    browser: Browser, server: FaultyServer, small: SmallScene
) -> None:
    server.files["poster.svg"] = b'<svg xmlns="http://www.w3.org/2000/svg" width="9" height="9"/>'
    url = embed(server, 'src="scene.cogs" lazy="click" poster="poster.svg"')
    with opened(browser, url) as page:
        poster = page.locator("#poster")
        expect(poster).to_be_visible()
        button = page.get_by_role("button", name="Show the scene")
        button.focus()
        assert server.traffic.size_bytes("scene.cogs") == 0
        server.hold_at(100)
        page.keyboard.press("Enter")
        wait_until(page, "s.state === 'opening'")
        expect(button).to_be_hidden()
        expect(poster).to_be_visible()
        server.hold_at(float("inf"))
        wait_until(page, COMPLETE)
        expect(page.locator("#loading")).to_be_hidden()


def test_turning_by_itself_ends_at_a_touch(browser: Browser, server: FaultyServer) -> None:
    url = embed(server, 'src="scene.cogs" auto-rotate="90"')
    with opened(browser, url) as page:
        wait_until(page, "s.splats > 0 && s.frames > 3")
        first = pose(page)
        wait_until(page, f"JSON.stringify(cogsplatViewer.view) !== {first!r}")
        page.evaluate(
            "() => cogsplatViewer.addEventListener('cogsplat-view', () => { window.rested = 1; })"
        )
        page.mouse.click(450, 200)
        wait_until(page, COMPLETE)
        page.wait_for_function("() => window.rested === 1")
        first = pose(page)
        page.wait_for_timeout(300)
        assert pose(page) == first
    with opened(browser, url, calm=True) as page:
        wait_until(page, COMPLETE)


def boxes(page: Page) -> dict[str, list[float]]:
    """Return the boxes of what stands over the picture, by id."""
    found: dict[str, list[float]] = page.evaluate(
        """() => Object.fromEntries(["message", "progress", "tools"].map((id) => {
          const box = cogsplatViewer.shadowRoot.getElementById(id).getBoundingClientRect();
          return [id, [box.left, box.top, box.right, box.bottom]];
        }))"""
    )
    return found


@pytest.mark.parametrize("share", [0.01, 0.5])
def test_a_file_cut_short_says_how_much_is_there(
    browser: Browser, server: FaultyServer, small: SmallScene, share: float
) -> None:
    data = small.cogs.read_bytes()
    server.files["scene.cogs"] = data[: int(share * len(data))]
    with opened(browser, server.url) as page:
        error = str(wait_until(page, "s.state === 'failed'")["error"])
        assert (
            f" of {len(data) / 1000:.0f} kB" in error or f" of {len(data) / 1000:.3g} kB" in error
        )
        assert f"{server.url}scene.cogs" in error
        for width in range(320, 531, 30):
            page.set_viewport_size({"width": width, "height": 400})
            found = list(boxes(page).values())
            for i, one in enumerate(found):
                assert 0 <= one[0] <= one[2] <= width
                for other in found[:i]:
                    apart = one[2] <= other[0] or other[2] <= one[0]
                    assert apart or one[3] <= other[1] or other[3] <= one[1], width
