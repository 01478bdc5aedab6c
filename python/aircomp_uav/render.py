"""The map of a mission as an array of pixels, without a window or a plotting library."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ._native import Mission

SIDE = 480
"""The length of the longer side, pixels."""
MARGIN = 16

BACKGROUND = (255, 255, 255)
AREA = (245, 246, 248)
SENSOR = (150, 160, 170)
USER = (31, 119, 180)
PATH = (214, 90, 40)
ENDS = (40, 40, 40)
SERVED = (255, 190, 60)


class Map:
    """The map of an episode: users, sensors, the path so far, and the user that is served."""

    def __init__(self, mission: Mission) -> None:
        self._east_m, self._north_m = mission.area_m
        self._scale = (SIDE - 2 * MARGIN) / max(self._east_m, self._north_m)
        width = round(self._east_m * self._scale) + 2 * MARGIN
        height = round(self._north_m * self._scale) + 2 * MARGIN
        self._base = np.empty((height, width, 3), np.uint8)
        self._base[:] = BACKGROUND
        self._base[MARGIN : height - MARGIN, MARGIN : width - MARGIN] = AREA
        self._users = mission.user_positions_m
        for place in mission.sensor_positions_m:
            self._disc(self._base, place, 3, SENSOR)
        for place in self._users:
            self._disc(self._base, place, 5, USER)
        for place in (mission.start_m, mission.destination_m):
            self._disc(self._base, place, 6, ENDS)
        self._last = mission.start_m
        self._served = -1

    def _pixel(self, place: npt.ArrayLike) -> tuple[float, float]:
        east_m, north_m = np.asarray(place, float).tolist()
        column = MARGIN + east_m * self._scale
        row = MARGIN + (self._north_m - north_m) * self._scale
        return column, row

    def _disc(
        self,
        image: npt.NDArray[np.uint8],
        place: npt.ArrayLike,
        radius: float,
        color: tuple[int, int, int],
    ) -> None:
        column, row = self._pixel(place)
        height, width, _ = image.shape
        left, right = max(0, int(column - radius)), min(width, int(column + radius) + 2)
        top, bottom = max(0, int(row - radius)), min(height, int(row + radius) + 2)
        rows, columns = np.ogrid[top:bottom, left:right]
        inside = (rows - row) ** 2 + (columns - column) ** 2 <= radius**2
        image[top:bottom, left:right][inside] = color

    def add(self, place_m: tuple[float, float], user: int) -> None:
        """Add a slot: where it ended, and who was served."""
        (column0, row0), (column1, row1) = self._pixel(self._last), self._pixel(place_m)
        steps = int(max(abs(column1 - column0), abs(row1 - row0))) + 1
        columns = np.rint(np.linspace(column0, column1, steps + 1)).astype(int)
        rows = np.rint(np.linspace(row0, row1, steps + 1)).astype(int)
        for shift in (0, 1):
            self._base[np.clip(rows + shift, 0, self._base.shape[0] - 1), columns] = PATH
        self._last = place_m
        self._served = user

    def draw(self) -> npt.NDArray[np.uint8]:
        """Return the pixels."""
        image = self._base.copy()
        if self._served >= 0:
            self._disc(image, self._users[self._served], 5, SERVED)
        self._disc(image, self._last, 5, PATH)
        return image

    def show(self) -> None:
        """Show the map in a notebook; outside of one this does nothing."""
        try:
            from IPython.core.getipython import get_ipython
            from IPython.display import Image, display
        except ImportError:
            return
        if get_ipython() is None:
            return
        display(Image(data=png(self.draw())), clear=True)


def png(image: npt.NDArray[np.uint8]) -> bytes:
    """Return an image as the bytes of a PNG file."""
    import struct
    import zlib

    def chunk(kind: bytes, data: bytes) -> bytes:
        checksum = zlib.crc32(kind + data)
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", checksum)

    height, width, _ = image.shape
    lines = np.zeros((height, 1 + 3 * width), np.uint8)
    lines[:, 1:] = image.reshape(height, -1)
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    body = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(lines.tobytes(), 6))
    return b"\x89PNG\r\n\x1a\n" + body + chunk(b"IEND", b"")
