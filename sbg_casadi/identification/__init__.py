"""Unknown numbers of a pair from measured responses."""

from sbg_casadi.identification.outcome import Identification, Settings
from sbg_casadi.identification.procedure import identify
from sbg_casadi.identification.targets_file import TargetsFile, load_targets, read_targets

__all__ = ["Identification", "Settings", "TargetsFile", "identify", "load_targets", "read_targets"]
