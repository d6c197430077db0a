"""The documented import of modal records; the code is in ``files.modal_record``."""

from .files.modal_record import ModalRecord, read_modal_record

__all__ = ["ModalRecord", "read_modal_record"]
