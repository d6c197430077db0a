"""The commands and their Python API; first of all, a check that the four packages of gyroscreen are those beside this one."""

from ._packages import check_packages

check_packages()
