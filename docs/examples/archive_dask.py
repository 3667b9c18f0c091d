"""Decode a plant's archive on a Dask cluster: each worker runs the same function as `pdgw decode -j`, on one file at a time.

Usage: python archive_dask.py FOLDER_OF_CAPTURES FOLDER [ADDRESS]     (ADDRESS of a scheduler; without it this machine)

All workers need both folders (a network share) and this package with its extra: pip install 'profidrive-gateway[archive]'.
"""

import sys
from pathlib import Path

from dask.distributed import Client, as_completed

from pdgw.tools.decoder.export.archive import ArchiveOptions, captures_of, write_part


def main() -> None:
    captures, folder, *address = sys.argv[1:]
    options = ArchiveOptions(signals=("NSOLL_A", "NIST_A", "ZSW1.FAULT"))
    options.knowledge()  # reports an error before the workers start
    with (
        Client(address[0]) if address else Client(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster
    ):
        futures = cluster.map(write_part, captures_of([captures]), root=Path(folder), options=options)
        for future in as_completed(futures):
            part = future.result()
            print(part.file, part.rows, part.error or "ok", sep="\t")


if __name__ == "__main__":
    main()
