"""Messages of refused configurations."""

from collections.abc import Callable
from typing import Any

import pytest

from wbc_controller.errors import ConfigurationError


def refusal(call: Callable[..., Any], *arguments: Any, **options: Any) -> str:
    """Return the message of the `ConfigurationError` that a call must raise."""
    with pytest.raises(ConfigurationError) as error:
        call(*arguments, **options)
    return str(error.value)
