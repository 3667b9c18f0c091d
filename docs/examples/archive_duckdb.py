"""Ask a data set of captures (`pdgw decode CAPTURES --parquet FOLDER --signal ...`): how fast each axis was, and when.

Usage: python archive_duckdb.py FOLDER      (needs the signals NIST_A and ZSW1.FAULT, and duckdb)
"""

import sys

import duckdb

QUERY = """
SELECT file, axis,
       min(make_timestamp_ns(time_ns))       AS first,
       round(max(abs(NIST_A)), 2)            AS fastest_percent,
       count(*) FILTER ("ZSW1.FAULT" = 1)    AS frames_in_fault
FROM read_parquet(? || '/**/*.parquet', hive_partitioning = true)
WHERE axis > 0
GROUP BY file, axis
ORDER BY file, axis
"""

folder = sys.argv[1]
for row in duckdb.sql(QUERY, params=[folder]).fetchall():
    print(*row, sep="\t")
