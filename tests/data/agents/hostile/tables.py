"""Fills page tables, which are not part of the resident memory."""

import mmap
import time

MAP_NORESERVE, MADV_NOHUGEPAGE = 0x4000, 15
SIZE = 210 << 30


def get_actor(module_dir, observation_space, action_space):
    kept = []

    def actor(state, observation):
        flags = mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | MAP_NORESERVE
        block = mmap.mmap(-1, SIZE, flags=flags, prot=mmap.PROT_READ)
        block.madvise(MADV_NOHUGEPAGE)
        for page in range(0, SIZE, 2 << 20):  # each needs a page table of its own
            block[page]
        kept.append(block)
        time.sleep(10)
        return action_space.sample()

    return actor
