"""`python -m mavfi` is the program `mavfi`."""

from mavfi.cli import main

main()
