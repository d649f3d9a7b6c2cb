"""The transformation that a plan describes, for the code of one function."""

from dataclasses import dataclass
from typing import Any

from mavfi.extras.hardening.duplicate import protect
from mavfi.extras.hardening.plan import FunctionPlan, Plan, check_code
from mavfi.ir.module import Module
from mavfi.ir.sources import shape_of


def protection_of(plan: Plan, function: str, signature: tuple[Any, ...]) -> "Protection | None":
    """Protection of a function (module and name) for the Numba types of its arguments; None = its code is plain."""
    found = plan.find(function, signature)
    return Protection(found) if found is not None and found.sites else None


@dataclass(frozen=True, slots=True)
class Protection:
    """Rewrites the module of a planned function; see `mavfi.ir.build.Rewrite`."""

    plan: FunctionPlan

    @property
    def key(self) -> bytes:
        """What determines the protected code; measured times and coverage do not."""
        return repr((self.plan.ir_sha256, self.plan.addresses, self.plan.libm, self.plan.sites)).encode()

    def __call__(self, module: Module) -> Module:
        """The protected module; a BadInputError if the plan was made for other code."""
        check_code(self.plan, *shape_of(module))
        return protect(module, self.plan.sites, addresses=self.plan.addresses)
