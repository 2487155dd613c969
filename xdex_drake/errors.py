"""The error family of the library.

Raised for bad input only. "No grasp was found" is a result with a reason, never an exception. The command line turns an
`XdexError` into one line on standard error and exit status 2.
"""


class XdexError(Exception):
    """Base class of the library's errors. The message names the file, the field and the remedy."""


class HandFileError(XdexError):
    """A hand file cannot be used."""


class UnknownHand(XdexError):
    """No hand has this name; the message lists the names that are known."""


class ObjectFileError(XdexError):
    """A mesh file cannot be used."""


class UnknownObject(XdexError):
    """No object has this name; the message lists the names that are known."""


class ProblemFileError(XdexError):
    """A problem file cannot be used."""


class GraspFileError(XdexError):
    """A file of grasps cannot be used."""


class DatasetError(XdexError):
    """A data set folder cannot be used."""


class ConfigError(XdexError):
    """A configuration file or a combination of options cannot be used."""


class CheckpointError(XdexError):
    """A checkpoint cannot be used."""


class MissingExtra(XdexError):
    """An optional dependency is not installed; the message names the extra to install."""
