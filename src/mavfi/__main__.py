"""Makes `python -m mavfi` equivalent to the program `mavfi`."""

from mavfi.cli import main

if __name__ == "__main__":  # not in processes that it spawns
    main()
