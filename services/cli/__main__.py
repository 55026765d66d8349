"""`python -m capture2vr.cli`: same as the command `capture2vr`."""

from capture2vr.cli.main import main

main()
