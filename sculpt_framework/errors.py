"""What can go wrong at the user's side: one typed exception, one clear line, exit code 2.

Everything else that is raised is a fault of ours and keeps its traceback.
"""


class SculptError(Exception):
    """The user's input or machine does not allow what was asked.

    The message is one line for people: what was given, what was expected, what to do. It stays one line where a name
    from the input holds line breaks.
    """

    def __init__(self, message: str):
        super().__init__(" ".join(message.split()))


class ConfigError(SculptError):
    """An option, a component name or a saved configuration is not valid."""


class UnknownComponentError(ConfigError):
    """No component of that name is registered in that slot."""


class ComponentImportError(ConfigError):
    """A registered component's package cannot be imported; the message names the package."""


class JobRefusedError(ConfigError):
    """A scheduler does not take a job; it may once others have ended."""


class DataError(SculptError):
    """The scene on disk is missing, malformed or cannot be reconstructed."""


class OutputError(SculptError):
    """Results cannot be written where the user asked."""


class CheckpointError(SculptError):
    """A saved run cannot be read back."""


class DeviceError(SculptError):
    """The asked-for device is not on this machine."""


class TrainingFailed(Exception):
    """Training could not go on, after repeated recovery; the message is one line that says why and what was saved.

    No SculptError: it may be the input, the settings or a fault of ours. Exit code 1.
    """


def first_line(error: BaseException) -> str:
    """Of what kind the error is, and the first line of what it says."""
    return f"{type(error).__name__}: {error}".splitlines()[0]
