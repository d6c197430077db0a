"""Sentences about the manual."""

BUILDING = "building the manual; this takes a minute or two"
