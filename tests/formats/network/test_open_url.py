import pytest

from cogsplat.formats.network.open_url import open_url


@pytest.mark.parametrize("wrong", ["scene.cogs", "ftp://a.b/c", "https://"])
def test_what_is_no_address_is_misuse(wrong):
    with pytest.raises(ValueError, match="expected a URL with http"):
        open_url(wrong)
