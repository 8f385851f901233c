"""Where the service keeps its data, in the ways an operator may say it."""

from pathlib import Path

import pytest
from pydantic import ValidationError

from joulemap.service.settings import Settings


@pytest.mark.parametrize(
    ("given", "folder"),
    [
        ("/srv/joulemap", "/srv/joulemap"),
        ("file:///srv/joulemap", "/srv/joulemap"),
        ("file:/srv/joulemap", "/srv/joulemap"),
        (Path("file:///srv/joulemap"), "/srv/joulemap"),
        ("file:///srv/our%20maps", "/srv/our maps"),
        ("data", "data"),
    ],
)
def test_the_data_folder_is_a_path_or_a_url(given, folder) -> None:
    assert Settings(data_dir=given).data_dir == Path(folder)


def test_another_kind_of_url_is_refused() -> None:
    with pytest.raises(ValidationError, match="s3:"):
        Settings(data_dir="s3://bucket/joulemap")
