"""`python -m services.cli`: the same as the console script `capture2vr`."""

from services.cli.main import main

main()
