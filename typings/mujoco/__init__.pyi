"""MuJoCo is a compiled module without types: whatever it is asked for is `Any`."""

from typing import Any

def __getattr__(name: str) -> Any: ...
