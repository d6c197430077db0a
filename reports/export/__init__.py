"""A night in the formats of other programs: STDF V4, Excel, wafer maps.  ``workflows`` reads the run and names the files."""
