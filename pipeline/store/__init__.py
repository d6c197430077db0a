"""Runs on disk: registered schema, commit protocol, verified reading, locked SQL.

Import from the modules: a worker needs the schema alone, and Parquet takes 13 MB of every worker.
"""
