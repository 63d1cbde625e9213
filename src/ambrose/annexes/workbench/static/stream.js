// The socket of the live rig: a frame is confirmed when it is drawn, and so asks for the next one.

// on: {frame(head, samples), told(message), lost(text)}
export function stream(on) {
  let [socket, closed, wait] = [null, false, 500];
  const connect = () => {
    if (closed || socket || document.hidden) return;
    const mine = new WebSocket(`ws://${location.host}/live`);
    socket = mine;
    mine.binaryType = "arraybuffer";
    mine.onmessage = (event) => {
      wait = 500;
      if (typeof event.data === "string") { on.told(JSON.parse(event.data)); return; }
      const length = new DataView(event.data).getUint32(0, true);
      const head = JSON.parse(new TextDecoder().decode(new Uint8Array(event.data, 4, length)));
      const samples = new Float32Array(event.data, 4 + length);
      requestAnimationFrame(() => {
        if (mine.readyState === WebSocket.OPEN) mine.send("ok"); // the next comes while this is drawn
        on.frame(head, samples);
      });
    };
    mine.onclose = () => {
      if (socket === mine) socket = null;
      if (closed || document.hidden) return;
      on.lost("The connection is lost; trying again. If the server was ended, start it again.");
      setTimeout(connect, wait);
      wait = Math.min(2 * wait, 8000);
    };
  };
  // a page that nobody sees lets the rig stand still
  const seen = () => (document.hidden ? socket?.close() : connect());
  document.addEventListener("visibilitychange", seen);
  connect();
  return {
    send: (message) => {
      if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
      else on.lost("There is no connection to the rig.");
    }, close: () => {
      closed = true;
      document.removeEventListener("visibilitychange", seen);
      socket?.close();
    }, };
}
