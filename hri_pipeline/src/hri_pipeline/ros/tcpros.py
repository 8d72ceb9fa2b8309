"""Messages over rospy's connections (TCPROS): sent at once, images received without copies, messages of any type.

Checked against rospy 1.15.15, as `rospy_compat.py` is: rospy/topics.py, rospy/impl/tcpros_base.py,
rospy/impl/tcpros_pubsub.py.
"""

from __future__ import annotations

import fcntl
import socket
import struct
import termios
from collections import deque
from io import BytesIO
from typing import Any, List, Union

import genpy
import numpy as np
import roslib.message
import rospy
import rospy.topics
from rospy.impl import tcpros_base, tcpros_pubsub
from sensor_msgs.msg import Image

_LENGTH = struct.Struct("<I")


def send_at_once() -> None:
    """Let publish() of this process send messages itself, over connections that are made from now on. Idempotent."""
    rospy.topics.QueuedConnection = PromptConnection


def receive_without_copies() -> None:
    """Let this process receive each ReceivedImage into one block of memory. Idempotent."""
    tcpros_pubsub.TCPROSSub.read_messages = _read_messages


class PromptConnection(tcpros_pubsub.QueuedConnection):
    """rospy's connection to a subscriber, which sends a message in the thread that publishes it as long as the system
    takes it at once. The rest waits for the thread of the connection, as all messages do in rospy.

    To wake that thread for each message took .03 ms more of processor time, and it had to wait for Python's lock. And
    rospy sleeps for 0 s after each, which gives up the time slice: with ten people a seventh of the time of each image.
    """

    def __init__(self, connection: Any, queue_size: int) -> None:
        self._begun: Union[bytes, memoryview] = b""     # what is left of a message, which must be sent
        self._is_sending = False
        super().__init__(connection, queue_size)

    def write_data(self, data: bytes) -> bool:
        """Send a message, or keep it; when the queue is full the oldest is lost. Raises an error of an earlier one."""
        with self._lock:
            if self._error:
                error, self._error = self._error, None
                raise error
            if not (self._queue or self._begun or self._is_sending):
                sent = self._send(data)
                if sent == len(data):
                    return True
                if sent:
                    self._begun = memoryview(data)[sent:]
                    self._cond_data_available.notify()
                    return True
            if 0 < self._queue_size <= len(self._queue):
                del self._queue[0]
            self._queue.append(data)
            self._cond_data_available.notify()
        return True

    def _send(self, data: bytes) -> int:
        """Return how many bytes the system has taken; errors come again when the thread sends the rest."""
        sender = getattr(self._connection, "socket", None)
        # With a time limit Python would wait until there is room. rospy's have none, once the headers are exchanged.
        if sender is None or sender.gettimeout() is not None:
            return 0
        try:
            sent: int = sender.send(data, socket.MSG_DONTWAIT)
        except OSError:
            return 0
        self._connection.stat_bytes += sent
        self._connection.stat_num_msg += sent == len(data)
        return sent

    def _run(self) -> None:
        while not self._connection.done:
            self._send_waiting()

    def _send_waiting(self) -> None:
        """Wait for messages, and send them: one round of the thread, after which nothing of them is kept."""
        with self._lock:
            self._is_sending = False
            self._cond_data_available.wait_for(lambda: self._queue or self._begun or self._connection.done)
            waiting = [self._begun] * bool(self._begun) + self._queue
            self._queue, self._begun, self._is_sending = [], b"", True
        for data in waiting:
            try:
                self._connection.write_data(data)
            except Exception as error:      # publish() is told with the next message
                with self._lock:
                    self._error = error


class ReceivedImage(Image):
    """An image whose data (a memoryview) is where the socket has put it: a type for rospy.Subscriber.

    To be used after receive_without_copies(), with the buff_size BUFFER_BYTES.
    """

    BUFFER_BYTES = 4
    """What rospy reads by itself: the length of a message."""

    def deserialize(self, block: Union[bytes, memoryview]) -> ReceivedImage:
        """Take the fields out of a serialized image, whose data are not copied. Raises DeserializationError."""
        try:
            end = 16 + _length(block, 12) + 8
            end += 4 + _length(block, end) + 5
            size = _length(block, end)
            if end + 4 + size > len(block):
                raise struct.error("{} bytes of data, {} are there".format(size, len(block) - end - 4))
            super().deserialize(bytes(block[:end]) + bytes(4))
        except struct.error as error:
            raise genpy.DeserializationError(error) from error
        self.data = memoryview(block)[end + 4:end + 4 + size]
        return self


class AnyMessage(rospy.AnyMsg):
    """A message of any type: a type for rospy.Subscriber. It has the fields of its own type, too.

    rospy gives all subscribers of a topic in one process the messages of the first one's type: with rospy.AnyMsg, a
    tf2_ros.TransformListener that the program makes later fails at each message.
    """

    def __getattr__(self, name: str) -> Any:
        """Return a field of the message. AttributeError when its type has none of that name, or cannot be read."""
        if name.startswith("_"):
            raise AttributeError(name)
        if "_read" not in self.__dict__:
            try:
                self._read = message_of(self)
            except (ValueError, genpy.DeserializationError) as error:
                raise AttributeError(str(error)) from error
        return getattr(self._read, name)

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Copies are messages of its own type."""
        return message_of(self).__reduce_ex__(protocol)


def message_of(message: genpy.Message) -> genpy.Message:
    """Return a message that came to a subscriber of any type, in its own type.

    Raises ValueError for a type that is not known here, genpy.DeserializationError for wrong bytes.
    """
    if not isinstance(message, rospy.AnyMsg):
        return message          # the program has subscribed to that type before
    name = message._connection_header.get("type", "")
    kind = roslib.message.get_message_class(name)
    if kind is None or message._connection_header.get("md5sum") not in (kind._md5sum, "*"):
        raise ValueError("its type {} is not known here, or is another version of it".format(name[:60]))
    return kind().deserialize(message._buff)


def bytes_of(message: genpy.Message) -> bytes:
    """Return what was sent of a message that came to a subscriber of any type."""
    if isinstance(message, rospy.AnyMsg):
        return message._buff
    buffer = BytesIO()
    message.serialize(buffer)
    return buffer.getvalue()


def _read_messages(protocol: tcpros_pubsub.TCPROSSub, b: BytesIO, msg_queue: List[genpy.Message],
                   sock: socket.socket) -> None:
    """Append what has come to a subscriber; `b` holds the beginning of the next message, with its length at least.

    The original copies each image five times, also those that nobody takes: 1.5 ms for 1280x720 pixels, a third of all
    that `bodies` does on a busy machine. A ReceivedImage is read into one block of memory instead.
    """
    if not issubclass(protocol.recv_data_class, ReceivedImage):
        tcpros_base.TCPROSTransportProtocol.read_messages(protocol, b, msg_queue, sock)
        return
    head = b.getvalue()[:b.tell()]
    b.seek(0)
    b.truncate(0)
    blocks = deque([_receive(sock, _length(head, 0), head[_LENGTH.size:])], protocol.queue_size)
    try:
        there, = struct.unpack("i", fcntl.ioctl(sock.fileno(), termios.FIONREAD, bytes(4)))
        while there >= _LENGTH.size:        # only what has come by now: a slow reader would never end
            size = _LENGTH.size + _length(sock.recv(_LENGTH.size, socket.MSG_PEEK), 0)
            there -= size
            if there >= 0:
                blocks.append(_receive(sock, size)[_LENGTH.size:])
    except (OSError, ValueError, struct.error) as error:
        raise tcpros_base.TransportTerminated("the connection was closed: {}".format(error)) from error
    msg_queue.extend(protocol.recv_data_class().deserialize(block) for block in blocks)


def _length(block: Union[bytes, memoryview], place: int) -> int:
    return int(_LENGTH.unpack_from(block, place)[0])


def _receive(sock: socket.socket, size: int, head: bytes = b"") -> memoryview:
    """Return `size` bytes, of which `head` has come before. Raises TransportTerminated when the connection ends."""
    block = memoryview(np.empty(size, np.uint8))
    done = len(head)
    block[:done] = head
    while done < size:
        try:
            got = sock.recv_into(block[done:])
        except OSError:
            got = 0
        if not got:
            raise tcpros_base.TransportTerminated("unable to receive data from sender, check its logs")
        done += got
    return block
