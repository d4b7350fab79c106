"""Pages hold what they need: the scene byte for byte, and hashes of their own script and style."""

import base64
import hashlib
import io
import re

from cogsplat.tools.delivery.viewer_pages import BLOCK_BYTES, linked_page, write_standalone_page

BLOCK = re.compile(r'<script type="application/x-cogs-base64">([^<]*)</script>')


def lone_page(scene: bytes) -> str:
    out = io.BytesIO()
    blocks = [scene[at : at + BLOCK_BYTES] for at in range(0, len(scene), BLOCK_BYTES)]
    write_standalone_page("a & b", blocks, out)
    return out.getvalue().decode()


def test_lone_page_holds_the_scene_in_blocks() -> None:
    scene = bytes(range(256)) * 30_000
    page = lone_page(scene)
    blocks = BLOCK.findall(page)
    assert len(blocks) == 3
    assert b"".join(base64.b64decode(block) for block in blocks) == scene
    assert "<title>a &amp; b</title>" in page


def test_lone_page_allows_its_own_script_and_style_alone() -> None:
    page = lone_page(b"scene")
    policy = re.search(r'content="(default-src[^"]*)"', page)
    assert policy is not None
    assert "'self'" not in policy[1]
    assert "connect-src" not in policy[1]
    tags = (
        ("script", '<script type="module">'),
        ("script", '<script type="application/x-cogs-extras">'),
        ("style", "<style>"),
    )
    for name, tag in tags:
        inside = page.partition(tag)[2].partition(f"</{name}")[0]
        assert len(inside) > 100
        digest = base64.b64encode(hashlib.sha256(inside.encode()).digest()).decode()
        assert f"'sha256-{digest}'" in policy[1]
    assert not re.search(r'(?:src|href)="', page)


def test_lone_page_holds_the_programs_of_its_workers() -> None:
    page = lone_page(b"scene")
    programs = re.findall(
        r'<script type="application/x-cogs-worker">(.*?)</script>', page, re.DOTALL
    )
    files = linked_page("t")
    assert programs == [files[name].decode() for name in ("worker.js", "viewer_worker.js")]
    assert "worker-src blob:" in page


def test_linked_page_names_the_scene() -> None:
    files = linked_page('"t"')
    page = files.pop("index.html").decode()
    assert 'label="&quot;t&quot;" src="scene.cogs">' in page
    referred = set(re.findall(r'(?:src|href)="([^"]+)"', page))
    programs = {"viewer_extras.js", "worker.js", "viewer_worker.js"}
    assert referred == files.keys() - programs | {"scene.cogs"}


def test_linked_page_names_what_the_scene_is_compared_with() -> None:
    page = linked_page("t", "a.cogs", "b.ply")["index.html"].decode()
    assert 'src="a.cogs" against="b.ply"' in page


def test_names_of_files_cannot_become_other_urls() -> None:
    names = {
        "https:evil.example.cogs": "https%3Aevil.example.cogs",
        "50%.cogs": "50%25.cogs",
        "a#b?c.cogs": "a%23b%3Fc.cogs",
        'say "hi" & go.cogs': "say%20%22hi%22%20%26%20go.cogs",
        "\udcff.cogs": "%FF.cogs",
        "scene/": "scene/",
    }
    for name, url in names.items():
        page = linked_page("scene", name, name)["index.html"].decode()
        assert f' src="{url}" against="{url}"' in page
