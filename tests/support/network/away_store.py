"""A store that does not answer for a while."""

from __future__ import annotations

from typing import Any

from capture2vr.storage.memory import MemoryStore


class AwayStore(MemoryStore):
    """A store of which every call fails while `is_away`."""

    is_away = False

    def put(self, *given: Any, **options: Any) -> Any:
        self._check()
        return super().put(*given, **options)

    def get(self, *given: Any, **options: Any) -> Any:
        self._check()
        return super().get(*given, **options)

    def head(self, *given: Any, **options: Any) -> Any:
        self._check()
        return super().head(*given, **options)

    def list(self, *given: Any, **options: Any) -> Any:
        self._check()
        return super().list(*given, **options)

    def delete(self, *given: Any, **options: Any) -> Any:
        self._check()
        return super().delete(*given, **options)

    def _check(self) -> None:
        if self.is_away:
            raise OSError("the S3 service cannot be reached")
