"""`python -m services.cli`: same as the command `capture2vr`."""

from services.cli.main import main

main()
