"""Upkeep of a cell's folder between versions: its format, its upgrade, its backup, and the restoring of a backup."""

from pcmrs.maintenance._backup import BackupReport, back_up
from pcmrs.maintenance._folder import FORMAT, enter_folder, hold_folder
from pcmrs.maintenance._formats import FileFormat, FolderCheck, check_folder, check_named_files
from pcmrs.maintenance._restore import RestoreReport, restore
from pcmrs.maintenance._upgrade import UpgradeReport, upgrade_folder

__all__ = [
    "FORMAT",
    "BackupReport",
    "FileFormat",
    "FolderCheck",
    "RestoreReport",
    "UpgradeReport",
    "back_up",
    "check_folder",
    "check_named_files",
    "enter_folder",
    "hold_folder",
    "restore",
    "upgrade_folder",
]
