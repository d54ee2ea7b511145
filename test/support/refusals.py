"""Messages of refused configurations and inputs."""

from collections.abc import Callable
from typing import Any

import pytest

from wbc_controller.errors import ConfigurationError, InputRefused


def refusal(call: Callable[..., Any], *arguments: Any, **options: Any) -> str:
    """Return the message of the `ConfigurationError` that a call must raise."""
    with pytest.raises(ConfigurationError) as error:
        call(*arguments, **options)
    return str(error.value)


def input_refusal(call: Callable[..., Any], *arguments: Any, **options: Any) -> str:
    """Return the message of the `InputRefused` that a call must raise."""
    with pytest.raises(InputRefused) as error:
        call(*arguments, **options)
    return str(error.value)
