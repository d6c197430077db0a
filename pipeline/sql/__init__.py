"""SQL in a process of its own: locked, limited, on files whose hash is checked when they are opened.

It imports no other part of the package, so that the process starts with duckdb and pyarrow alone.
"""
