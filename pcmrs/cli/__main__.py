"""``python -m pcmrs.cli``."""

from pcmrs.cli import main

main()
