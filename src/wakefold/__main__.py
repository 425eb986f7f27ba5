"""``python -m wakefold`` is the ``wakefold`` command."""

from wakefold.cli import main

if __name__ == "__main__":
    main()
