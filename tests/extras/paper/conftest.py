from tests.core.unit.analysis.conftest import fake  # noqa: F401
from tests.core.unit.report.conftest import flown  # noqa: F401
