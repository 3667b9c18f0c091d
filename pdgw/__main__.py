"""``python -m pdgw`` is the command ``pdgw``. Nothing is imported here: what a Ctrl-C interrupts has to be inside ``run``."""

_INTERRUPTED = 130


def run() -> None:
    """Entry point of the console script: a Ctrl-C while the command is still being loaded ends it without a word, status 130.

    Modules stay: looking for garbage while they are loaded takes an eighth of the time. The command's table lets it begin again.
    """
    try:
        import gc  # noqa: PLC0415
        import os  # noqa: PLC0415
        import signal  # noqa: PLC0415

        before = signal.getsignal(signal.SIGINT)
        if before is signal.default_int_handler:
            # End without an exception: some parts of the import system would only print it.
            signal.signal(signal.SIGINT, lambda *_: os._exit(_INTERRUPTED))
        gc.disable()
        from pdgw.tools.cli import main  # noqa: PLC0415

        signal.signal(signal.SIGINT, before)
        main()
    except KeyboardInterrupt:
        raise SystemExit(_INTERRUPTED) from None


if __name__ == "__main__":
    run()
