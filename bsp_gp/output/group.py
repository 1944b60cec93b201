"""Results that are written together: a folder, and folders and files beside it with its name."""

import contextlib
import os
import shutil
from contextlib import contextmanager

from bsp_gp.errors import OutputError
from bsp_gp.output.journal import NOTE, carry_out, write_note
from bsp_gp.output.mark import file_digest, mark_folder, read_mark
from bsp_gp.output.place import claim, require_free, told
from bsp_gp.output.replacing import new_folder, prepare


class Group:
    """Places that are held together, from `claim_group`."""

    def __init__(self, main, folders, files, overwrite):
        self.path = main.path
        self.main, self._folders, self._files = main, folders, files
        self._overwrite = overwrite

    def beside(self, suffix):
        """The path of one of the places."""
        return self.path.with_name(self.path.name + suffix)

    def require_free(self):
        """Refuse what may not be replaced, in any of the places."""
        for suffix, kind in self._folders.items():
            require_free(self.beside(suffix), kind, self._overwrite)
        mark = read_mark(self.path)
        for suffix in self._files:
            path = self.beside(suffix)
            if not os.path.lexists(path):
                continue
            known = mark.beside.get(path.name) if mark is not None else None
            if known is None or file_digest(path) != known:
                raise OutputError(
                    f"{path}: exists already and is not, or not any more, as it was written with "
                    f"{self.path.name}; move it away or choose another --out"
                )

    @contextmanager
    def fill(self):
        """Write all of them whole or none: yields where to, a path for each ending.

        Folders are there and empty. One that stays empty, or a file that is not written, means
        that there is no such result, and an older one goes away.
        """
        with told(self.path):
            staged = new_folder(self.path, "set")
            try:
                paths = {s: staged / self.beside(s).name for s in (*self._folders, *self._files)}
                for suffix in self._folders:
                    paths[suffix].mkdir()
                yield paths
                self._decide(staged, paths)
                self.main.kept += carry_out(staged, self.path)
            finally:
                if not (staged / NOTE).exists():
                    shutil.rmtree(staged, ignore_errors=True)

    def _decide(self, staged, paths):
        gone = []
        for suffix, path in paths.items():
            if suffix in self._folders and not os.listdir(path):
                path.rmdir()
            if not path.exists():
                gone.append(self.beside(suffix))
        digests = {paths[s].name: file_digest(paths[s]) for s in self._files if paths[s].exists()}
        for suffix, kind in self._folders.items():
            if paths[suffix].exists():
                mark_folder(paths[suffix], kind, None if suffix else digests)
        self.require_free()
        for suffix in self._folders:
            if paths[suffix].exists():  # what may fail does so while all can still be left as it is
                prepare(paths[suffix], self.beside(suffix))
        write_note(staged, self.path, [path for path in gone if os.path.lexists(path)])


@contextmanager
def claim_group(folder, folders, files, *, overwrite=False):
    """Hold the places of results that belong together.

    Parameters
    ----------
    folder : path
        Of the first.
    folders : dict
        Kind of result by the ending of its name; that of the first is "".
    files : iterable of str
        Endings of the names of files.
    overwrite : bool
        See `claim`.

    Yields
    ------
    Group

    Raises
    ------
    OutputError
        See `claim`.
    """
    with contextlib.ExitStack() as stack:
        main = stack.enter_context(claim(folder, folders[""], overwrite=overwrite))
        group = Group(main, folders, files, overwrite)
        for suffix, kind in folders.items():
            if suffix:
                stack.enter_context(claim(group.beside(suffix), kind, overwrite=overwrite))
        with told(group.path):
            group.require_free()
        yield group
