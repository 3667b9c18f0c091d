"""The SDO server of simulated nodes: canopen's, with block upload.

Source: CiA DS 301 V4.02 chapter 7.2.4.3 (SDO block upload protocol). Not implemented: block download, which canopen's server
aborts as the standard permits.
"""

from __future__ import annotations

import struct
from binascii import crc_hqx
from typing import Any

from canopen.sdo import SdoServer

from pdgw.ds301.aborts import Abort
from pdgw.ds301.node.sdo import SEGMENT_SIZE
from pdgw.ds301.sdo_transfer import SdoAbortedError

_INITIATE, _END, _ACKNOWLEDGE, _START = range(4)
_RESPONSE = 0xC0
_CRC, _SIZE = 0x04, 0x02
_LAST_SEGMENT = 0x80
_BLOCK_MAX = 127
_HEADER = struct.Struct("<BHB")


class BlockSdoServer(SdoServer):  # type: ignore[misc]  # partly typed package
    """Serves block uploads in addition to expedited and segmented transfers."""

    def __init__(self, rx_cobid: int, tx_cobid: int, node: Any) -> None:
        super().__init__(rx_cobid, tx_cobid, node)
        self._data = b""
        self._offset = 0
        self._block_size = 0
        self._crc_requested = False
        self._uploading = False

    def block_upload(self, request: bytes) -> None:
        """Process one request of a block upload: initiate, start, acknowledge of a block, or end."""
        command = request[0] & 0x03
        if command == _INITIATE:
            self._initiate(request)
        elif not self._uploading:
            raise SdoAbortedError(Abort.INVALID_COMMAND)
        elif command == _START:
            self._send_block()
        elif command == _ACKNOWLEDGE:
            self._acknowledged(request[1], request[2])
        else:
            self._uploading = False

    def _initiate(self, request: bytes) -> None:
        command, index, subindex = _HEADER.unpack_from(request)
        self._index, self._subindex = index, subindex
        self._set_block_size(request[4])
        self._data = bytes(self._node.get_data(index, subindex, check_readable=True))
        self._offset = 0
        self._crc_requested = bool(command & _CRC)
        self._uploading = True
        answer = _HEADER.pack(_RESPONSE | _CRC | _SIZE | _INITIATE, index, subindex)
        self.send_response(bytearray(answer + struct.pack("<I", len(self._data))))

    def _set_block_size(self, size: int) -> None:
        if not 1 <= size <= _BLOCK_MAX:
            self._uploading = False
            raise SdoAbortedError(Abort.INVALID_BLOCK_SIZE)
        self._block_size = size

    def _send_block(self) -> None:
        for number in range(1, self._block_size + 1):
            offset = self._offset + (number - 1) * SEGMENT_SIZE
            last = offset + SEGMENT_SIZE >= len(self._data)
            segment = self._data[offset : offset + SEGMENT_SIZE].ljust(SEGMENT_SIZE, b"\0")
            self.send_response(bytearray(bytes([number | (_LAST_SEGMENT if last else 0)]) + segment))
            if last:
                break

    def _acknowledged(self, number: int, size: int) -> None:
        """The client has received the segments up to ``number``. Send the rest of the block again."""
        if number > self._block_size:
            self._uploading = False
            raise SdoAbortedError(Abort.INVALID_SEQUENCE_NUMBER)
        self._offset += number * SEGMENT_SIZE
        if self._offset < len(self._data):
            self._set_block_size(size)
            self._send_block()
            return
        unused = -len(self._data) % SEGMENT_SIZE
        crc = crc_hqx(self._data, 0) if self._crc_requested else 0
        self.send_response(bytearray(struct.pack("<BH5x", _RESPONSE | unused << 2 | _END, crc)))
