"""robosuite's robots that the installed MuJoCo refuses, mended and registered anew under the same names."""

from robosuite.models.robots import Sawyer as _Sawyer


class Sawyer(_Sawyer):  # type: ignore[misc]
    """Its meshes, all of them only to be looked at, are taken as shells: MuJoCo 3.9 wants a volume that one has not."""

    def __init__(self, idn: int = 0) -> None:
        super().__init__(idn)
        for mesh in self.asset.iter("mesh"):
            mesh.set("inertia", "shell")
