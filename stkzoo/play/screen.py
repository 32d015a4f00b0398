"""Window of the keyboard driver, which shows frames and tracks the keys that are held down."""

from __future__ import annotations

import os
import time
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo._imports import import_extra
from stkzoo._os import check_display
from stkzoo.env.keyboard import KEYS
from stkzoo.errors import ConfigError

_TITLE = "stkzoo play"
_BAR = 30  # height of the text bar [pixels]
_BAR_COLOR, _TEXT_COLOR, _FAINT_COLOR = (20, 24, 32), (235, 240, 245), (150, 160, 175)
_HELP = "P pause   Esc leave"
_NEED = "the race is shown in a window"
#: SDL's drivers for windows that nobody sees.
_INVISIBLE = ("dummy", "offscreen")


class PlayScreen:
    """A window with a frame and a line of text below it.

    Attributes:
        pressed: codes of the driving keys that are held down (:mod:`stkzoo.env.keyboard`).
        is_paused: whether the race is paused (P key).
        is_left: whether Escape was pressed or the window was closed.

    Args:
        size: width and height of the frame [pixels].

    Raises:
        ConfigError: pygame is not installed, or no display can be used.
    """

    def __init__(self, size: tuple[int, int]) -> None:
        self._pygame = pygame = _load_pygame()
        _open_display(pygame)
        pygame.font.init()
        pygame.display.set_caption(_TITLE)
        self._window = pygame.display.set_mode((size[0], size[1] + _BAR), pygame.RESIZABLE)
        self._font = pygame.font.Font(None, 22)
        self._driving = frozenset(key.code for key in KEYS)
        self.pressed: set[int] = set()
        self.is_paused = False
        self.is_left = False

    def listen(self) -> None:
        """Handles keyboard and window events."""
        pygame = self._pygame
        for event in pygame.event.get():
            if event.type == pygame.QUIT:
                self.is_left = True
            elif event.type == pygame.KEYDOWN:
                self._press(event.key)
            elif event.type == pygame.KEYUP:
                self.pressed.discard(event.key)
            elif event.type == pygame.WINDOWFOCUSLOST:
                self.pressed.clear()  # another window gets their key-up events

    def show(self, picture: npt.NDArray[np.uint8], text: str) -> None:
        """Shows a frame and a line of text.

        Args:
            picture: frame, ``(H, W, 3)`` uint8. It is scaled to the size of the window.
            text: text below the frame.
        """
        pygame, window = self._pygame, self._window
        width, height = window.get_size()
        scale = min(width / picture.shape[1], max(1, height - _BAR) / picture.shape[0])
        size = round(picture.shape[1] * scale), round(picture.shape[0] * scale)
        surface = pygame.surfarray.make_surface(picture.swapaxes(0, 1))
        if size != surface.get_size():
            surface = pygame.transform.smoothscale(surface, size)
        window.fill(_BAR_COLOR)
        window.blit(surface, ((width - size[0]) // 2, (height - _BAR - size[1]) // 2))
        self._write(text, width, height)
        pygame.display.flip()

    def wait(self, deadline: float) -> None:
        """Handles events until a deadline (:func:`time.monotonic`) or until the person leaves."""
        self.listen()
        while not self.is_left and (left := deadline - time.monotonic()) > 0:
            time.sleep(min(left, 0.01))
            self.listen()

    def close(self) -> None:
        """Closes the window."""
        self._pygame.display.quit()

    def _press(self, key: int) -> None:
        if key in self._driving:
            self.pressed.add(key)
        elif key == self._pygame.K_p:
            self.is_paused = not self.is_paused
        elif key == self._pygame.K_ESCAPE:
            self.is_left = True

    def _write(self, text: str, width: int, height: int) -> None:
        top = height - _BAR + 8
        line: Any = self._font.render(text, True, _TEXT_COLOR)
        self._window.blit(line, (10, top))
        hint = self._font.render(_HELP, True, _FAINT_COLOR)
        if line.get_width() + hint.get_width() + 40 <= width:
            self._window.blit(hint, (width - hint.get_width() - 10, top))


def _load_pygame() -> Any:
    """Returns the module ``pygame``.

    Raises:
        ConfigError: pygame is not installed, or there is no display.
    """
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    pygame = import_extra("pygame", "the window needs", "races")
    if not os.environ.get("SDL_VIDEODRIVER"):  # tests choose one that opens no window
        check_display(_NEED)
    return pygame


def _open_display(pygame: Any) -> None:
    """Initializes pygame's display.

    Raises:
        ConfigError: the display does not answer. SDL would open an invisible window or fail.
    """
    try:
        pygame.display.init()
        driver = pygame.display.get_driver()
    except pygame.error as error:
        problem = str(error)
    else:
        if driver not in _INVISIBLE or os.environ.get("SDL_VIDEODRIVER"):
            return
        pygame.display.quit()
        problem = "the display that DISPLAY or WAYLAND_DISPLAY names does not answer"
    raise ConfigError(f"{_NEED}, but {problem}; start a desktop session, or use `xvfb-run`")
