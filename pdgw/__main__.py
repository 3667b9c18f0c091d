"""``python -m pdgw`` is the command ``pdgw``."""

import gc
import signal


def run() -> None:
    """Entry point of the console script: a Ctrl-C while the command is still being loaded ends it without a word.

    Modules stay: looking for garbage while they are loaded takes an eighth of the time. The command's table lets it begin again.
    """
    before = signal.signal(signal.SIGINT, signal.SIG_DFL)
    gc.disable()
    from pdgw.tools.cli import main  # noqa: PLC0415

    signal.signal(signal.SIGINT, before)
    main()


if __name__ == "__main__":
    run()
