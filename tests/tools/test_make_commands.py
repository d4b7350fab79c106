"""The reference of commands is the help that they print."""

from cogsplat.tools import make_commands


def test_the_page_is_what_the_commands_say() -> None:
    page = (make_commands.ROOT / make_commands.PAGE).read_text(encoding="utf-8")
    assert page == make_commands.page(), "run python -m cogsplat.tools.make_commands"
    assert page.count("\n## cogsplat ") > 25
    assert "--target-size" in page
