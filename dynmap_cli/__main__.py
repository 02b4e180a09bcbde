"""Run as `python -m dynmap_cli`."""

from dynmap_cli.cli import main

main()
