"""Compile the code of flights on all processors, before the workers of pytest would each compile the same.

python -m tests.warm_up
"""

import os

from mavfi.campaign.config import load_campaign
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.warm_up import compile_ahead


def main():
    campaigns = [load_campaign(name) for name in ("table1_instructions", "lasting")]
    compile_ahead(campaigns, LocalExecutor(os.cpu_count() or 1))


if __name__ == "__main__":
    main()
