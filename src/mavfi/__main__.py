"""Makes `python -m mavfi` equivalent to the program `mavfi`."""

from mavfi.cli import main

main()
