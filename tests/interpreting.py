"""Triton's interpreter without a third of its work."""

from collections.abc import Callable
from typing import Any


def spare_the_interpreter() -> None:
    """Let a kernel give Triton's functions their interpreted forms once a module, not at each call of a function.

    The interpreter looks through the whole of Triton's language before every such call. Versions that do so in another
    way are left as they are.
    """
    from triton.runtime import interpreter

    patch: Callable[[Any], Any] | None = getattr(interpreter, "_patch_lang", None)
    if patch is None or not hasattr(interpreter, "_LangPatchScope") or hasattr(patch, "spared"):
        return
    seen: set[int] = set()
    """Globals of modules whose functions the kernel that runs has called."""

    def patch_once(function: Any) -> Any:
        first, module = not seen, id(function.__globals__)
        if module in seen:
            return None
        scope = patch(function)
        seen.add(module)
        if first:
            # The kernel's own, which it takes back at its end; nobody takes back those of functions it calls.
            restore = scope.restore

            def restore_all() -> None:
                seen.clear()
                restore()

            scope.restore = restore_all
        return scope

    patch_once.spared = True
    interpreter._patch_lang = patch_once
