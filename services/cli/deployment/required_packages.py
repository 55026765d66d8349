"""Lists the packages that an extra of an installed distribution needs, with the versions that are installed."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import metadata

from packaging.markers import Marker
from packaging.requirements import Requirement


@dataclass(frozen=True, slots=True)
class RequiredPackage:
    """A package that is needed, and what there is of it.

    wanted     versions that suit, such as ">=1.2"; empty: all
    installed  its version, None where it is missing
    """

    name: str
    wanted: str
    installed: str | None
    suits: bool

    @classmethod
    def of(cls, requirement: Requirement) -> RequiredPackage:
        name, wanted = requirement.name, str(requirement.specifier)
        try:
            installed = metadata.version(name)
        except metadata.PackageNotFoundError:
            return cls(name, wanted, None, suits=False)
        return cls(name, wanted, installed, suits=requirement.specifier.contains(installed, prereleases=True))

    def __str__(self) -> str:
        if self.installed is None:
            return self.name
        return f"{self.name} {self.installed}" if self.suits else f"{self.name}{self.wanted}, not {self.installed}"


def required_packages(distribution: str, extra: str) -> list[RequiredPackage]:
    """List the packages that an extra requires on this machine, with what their extras require, by name.

    Raises PackageNotFoundError where the distribution itself is missing.
    """
    requirements = map(Requirement, metadata.requires(distribution) or ())
    found: dict[str, RequiredPackage] = {}
    for requirement in (each for each in requirements if _is_of(extra, each.marker)):
        package = found[requirement.name] = RequiredPackage.of(requirement)
        for inner in requirement.extras if package.installed else ():
            found |= {each.name: each for each in required_packages(requirement.name, inner)}
    return [found[name] for name in sorted(found)]


def _is_of(extra: str, marker: Marker | None) -> bool:
    """Return whether a requirement applies on this machine because of this extra alone."""
    return marker is not None and marker.evaluate({"extra": extra}) and not marker.evaluate({"extra": ""})
