import pytest

from helpers.fuzz.child import Child


@pytest.fixture(scope="module")
def child(tmp_path_factory):
    with Child(tmp_path_factory.mktemp("child")) as begun:
        yield begun
