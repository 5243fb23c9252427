"""Run the command line: ``python -m sbg_casadi``."""

from sbg_casadi.cli import main

if __name__ == "__main__":
    main()
