from tests.core.unit.analysis.conftest import fake  # noqa: F401
