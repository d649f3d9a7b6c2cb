"""The table of compiled functions on its way to another process."""

import pickle
import subprocess
import sys

from mavfi.pipeline.functions import PLAIN

LOOK = """
import pickle, sys
from mavfi.kernels.perception import octomap
from mavfi.pipeline.functions import PLAIN
there = pickle.loads(sys.stdin.buffer.read())
print(there == PLAIN, there.insert_scan is octomap.insert_scan)
"""


def test_another_process_has_its_own_compiled_functions_not_copies_to_be_compiled_again():
    done = subprocess.run([sys.executable, "-c", LOOK], input=pickle.dumps(PLAIN), capture_output=True, check=True)
    assert done.stdout.split() == [b"True", b"True"]
