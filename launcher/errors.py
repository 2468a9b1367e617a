"""Errors for the user of the entry script; each message is one sentence."""

from __future__ import annotations


class LauncherError(Exception):
    """A verb cannot do what was requested.

    Attributes:
        exit_status: Exit status of the entry script.
    """

    exit_status = 1


class UsageError(LauncherError):
    """The command line, or a file that it names, is wrong."""

    exit_status = 2


class SetupError(LauncherError):
    """The virtual environment cannot be set up."""


class DomainError(LauncherError):
    """No ROS domain is available."""


class RunFolderError(LauncherError):
    """The folder of a run cannot be created or read."""
