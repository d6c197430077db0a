"""Sentences about the manual."""

BUILDING = "building the manual; this takes a minute or two"
NOT_BUILT = "the manual was not built:\n{faults}"
CORRECT = "correct the pages named, or build without --strict"
CORRECT_OR_SKIP = "correct what is named; --no-notebooks builds the manual without executing its notebooks"
