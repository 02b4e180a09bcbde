"""What all tests share: the Hypothesis profile and where the real recordings are."""

from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("dynmap", deadline=None, derandomize=True, max_examples=60)
settings.load_profile("dynmap")

PROJECT = Path(__file__).resolve().parent.parent
REAL_DATA = PROJECT.parent / "shared" / "data"


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Folder of the real recordings; tests that need it skip where it is absent."""
    if not REAL_DATA.is_dir():
        pytest.skip(f"no real recordings at {REAL_DATA}")
    return REAL_DATA


@pytest.fixture(scope="session")
def sample_logs() -> Path:
    """Folder of the two simulated recordings that come with the project."""
    return PROJECT / "sample_logs"


@pytest.fixture(scope="session")
def corridor(sample_logs: Path, tmp_path_factory: pytest.TempPathFactory):
    """The sample recordings through the whole chain, built once for all tests."""
    from tests.golden.corridor import make_corridor

    return make_corridor(sample_logs, tmp_path_factory.mktemp("corridor"), threads=2)
