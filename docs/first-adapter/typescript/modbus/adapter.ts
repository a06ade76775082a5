// A Modbus TCP adapter: the TypeScript SDK and modbus-serial.
import { McpServer } from "@modelcontextprotocol/sdk/server/mcp.js";
import ModbusRTU from "modbus-serial";
import { connect, type Socket } from "node:net";
import { z } from "zod";

import { Failure, inTurn, serve, TIMEOUT_MS, tool } from "../tools.ts";

const host = process.env.MODBUS_HOST ?? "127.0.0.1";
const port = Number(process.env.MODBUS_PORT ?? 502);
const unit = Number(process.env.MODBUS_UNIT ?? 1);

type Client = InstanceType<typeof ModbusRTU.default>;

// MODBUS Application Protocol V1.1b3, section 7.
const EXCEPTIONS: Record<number, string> = {
  1: "unsupported_operation",
  2: "illegal_address",
  3: "illegal_value",
  4: "device_failure",
  5: "accepted_pending",
  6: "device_busy",
  8: "device_failure",
  10: "gateway_path_unavailable",
  11: "gateway_target_no_response",
};

interface Connection {
  client: Client;
  socket: Socket;
  /** Fails when the connection ends, or brings what is no Modbus. */
  end: Promise<never>;
}

let connection: Connection | undefined;

async function open(): Promise<Connection> {
  const socket = connect({ host, port });
  await new Promise<void>((resolve, reject) => {
    setTimeout(() => reject(new Error("no connection in time")), TIMEOUT_MS).unref();
    socket.once("connect", resolve).once("error", reject);
  }).catch((error: Error) => {
    socket.destroy();
    throw new Failure("connect_failed", `${host}:${port}: ${error.message}`);
  });
  const end = new Promise<never>((_, reject) => {
    // modbus-serial does not tell a request that waits for its answer that the connection ended.
    socket.on("error", () => undefined).once("close", () => {
      reject(new Failure("connection_lost", "the connection ended before the answer came"));
    });
    // modbus-serial compares transaction, unit, function and length, and not the protocol identifier.
    let received = Buffer.alloc(0);
    socket.on("data", (bytes: Buffer) => {
      received = Buffer.concat([received, bytes]);
      if (received.length >= 4 && received.readUInt16BE(2) !== 0) {
        reject(new Failure("protocol_error", "the answer is none of Modbus"));
      }
      // There is one request at a time, so that the next bytes after a whole answer begin another one.
      if (received.length >= 6 && received.length >= 6 + received.readUInt16BE(4)) received = Buffer.alloc(0);
    });
  });
  end.catch(() => undefined);
  const client = new ModbusRTU.default();
  // Without a time-out modbus-serial waits for ever.
  client.setTimeout(TIMEOUT_MS);
  client.setID(unit);
  await client.linkTCP(socket, { port });
  return { client, socket, end };
}

/** Send one request; after any failure but an exception of the device the connection is not used again. */
function exchange<T>(signal: AbortSignal, request: (client: Client) => Promise<T>): Promise<T> {
  return inTurn(signal, async () => {
    if (!connection?.client.isOpen) connection = await open();
    const { client, socket, end } = connection;
    try {
      return await Promise.race([request(client), end]);
    } catch (error) {
      // Some errors of modbus-serial are no Error: String(error) is "[object Object]".
      const { modbusCode, name, message } = error as { modbusCode?: number; name?: string; message?: string };
      if (modbusCode !== undefined) throw new Failure(EXCEPTIONS[modbusCode] ?? "protocol_error", String(message));
      // An answer that comes late must not be taken for that of the next request.
      connection = undefined;
      socket.destroy();
      if (error instanceof Failure) throw error;
      if (name === "PortNotOpenError") throw new Failure("connection_lost", "the connection ended; nothing was sent");
      if (name === "TransactionTimedOutError") throw new Failure("timeout", "no answer in time");
      throw new Failure("protocol_error", `the answer does not fit the request: ${message}`);
    }
  });
}

const address = z.int().min(0).max(65535).describe("Address on the wire, from 0");
const count = z.int().min(1).max(125).default(1).describe("How many registers");

const server = new McpServer({ name: "acme-modbus", version: "1.1.0" });

for (const [table, read] of [
  ["holding", (client: Client, at: number, many: number) => client.readHoldingRegisters(at, many)],
  ["input", (client: Client, at: number, many: number) => client.readInputRegisters(at, many)],
] as const) {
  tool(
    server,
    {
      name: `read_${table}_registers`,
      description: `Read ${table} registers as unsigned 16-bit numbers`,
      writes: false,
      arguments: { address, count },
    },
    async (given, signal) => {
      if (given.address + given.count > 65536) throw new Failure("illegal_address", "the last register is 65535");
      const values = await exchange(signal, async (client) => {
        const { data } = await read(client, given.address, given.count);
        if (data.length !== given.count) throw new Error(`${data.length} registers instead of ${given.count}`);
        return data;
      });
      return { values };
    },
  );
}

tool(
  server,
  {
    name: "write_register",
    description: "Write one holding register",
    writes: true,
    arguments: { address, value: z.int().min(0).max(65535).describe("Unsigned 16-bit number") },
  },
  async (given, signal) => {
    await exchange(signal, async (client) => {
      const echo = await client.writeRegister(given.address, given.value);
      if (echo.address !== given.address || echo.value !== given.value) {
        throw new Error(`the device acknowledged ${echo.value} at ${echo.address}; a write may have been done`);
      }
    });
    return { address: given.address, value: given.value };
  },
);

await serve(server, () => void connection?.socket.destroy());
