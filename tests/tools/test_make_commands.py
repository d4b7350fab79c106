"""The reference of commands is the help that they print."""

import subprocess
import sys

from cogsplat.tools import make_commands


def test_the_page_is_what_the_commands_say() -> None:
    page = (make_commands.ROOT / make_commands.PAGE).read_text(encoding="utf-8")
    # In a process of its own, since click keeps the names of a help option from its first use.
    code = (
        "import sys; from cogsplat.tools import make_commands;"
        "sys.stdout.buffer.write(make_commands.page().encode())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
    assert page == done.stdout.decode(), "run python -m cogsplat.tools.make_commands"
    assert page.count("\n## cogsplat ") > 25
    assert "--target-size" in page
