// An OPC UA adapter: the TypeScript SDK and node-opcua.
import { McpServer } from "@modelcontextprotocol/sdk/server/mcp.js";
import {
  AttributeIds,
  type ClientSession,
  DataType,
  getBuiltInDataType,
  OPCUAClient,
  resolveNodeId,
  StatusCode,
  TimestampsToReturn,
  Variant,
  VariantArrayType,
} from "node-opcua-client";
import { z } from "zod";

import { Failure, inTurn, serve, TIMEOUT_MS, tool } from "../tools.ts";

// Standard output is for messages of MCP alone, and node-opcua writes its warnings there.
console.log = console.error;

const url = process.env.OPCUA_URL ?? "opc.tcp://127.0.0.1:4840";

const CODES: Record<string, string> = {
  BadNodeIdUnknown: "illegal_address",
  BadNodeIdInvalid: "illegal_address",
  BadAttributeIdInvalid: "illegal_address",
  BadNotReadable: "not_readable",
  BadNotWritable: "not_writable",
  BadUserAccessDenied: "access_denied",
  BadTypeMismatch: "type_mismatch",
  BadOutOfRange: "illegal_value",
  BadTimeout: "timeout",
};

let connection: { client: OPCUAClient; session: ClientSession } | undefined;

async function open(): Promise<NonNullable<typeof connection>> {
  const client = OPCUAClient.create({
    endpointMustExist: false,
    // node-opcua tries for ever, and sends what waited when it has a connection again.
    connectionStrategy: { maxRetry: 0 },
    transportTimeout: TIMEOUT_MS,
    defaultTransactionTimeout: TIMEOUT_MS,
  });
  client.on("start_reconnection", () => drop());
  try {
    await client.connect(url);
    return (connection = { client, session: await client.createSession() });
  } catch (error) {
    client.disconnect().catch(() => undefined);
    throw new Failure("connect_failed", `${url}: ${(error as Error).message}`);
  }
}

async function drop(): Promise<void> {
  const client = connection?.client;
  connection = undefined;
  await client?.disconnect().catch(() => undefined);
}

/** Do one exchange with the server, within the time that it has; after a failure of it the connection is not used again. */
function exchange<T>(signal: AbortSignal, ask: (session: ClientSession) => Promise<T>): Promise<T> {
  return inTurn(signal, async () => {
    let timer: NodeJS.Timeout | undefined;
    const late = new Promise<never>((_, reject) => {
      timer = setTimeout(() => reject(new Failure("timeout", "no answer of the server in time")), TIMEOUT_MS);
    });
    try {
      const work = (async () => ask((connection ?? (await open())).session))();
      work.catch(() => undefined);
      return await Promise.race([work, late]);
    } catch (error) {
      if (error instanceof Failure && !["timeout", "connect_failed"].includes(error.code)) throw error;
      void drop();
      throw error instanceof Failure ? error : new Failure("connection_lost", (error as Error).message);
    } finally {
      clearTimeout(timer);
    }
  });
}

function check(status: StatusCode): void {
  if (status.isGood()) return;
  const severity = status.value >>> 30;
  if (severity === 1) return;
  throw new Failure(CODES[status.name] ?? "device_failure", status.toString());
}

/** The whole numbers of each type: the least and the greatest. */
const BOUNDS: Partial<Record<DataType, [bigint, bigint]>> = {};
for (const bits of [8, 16, 32, 64]) {
  const [signed, unsigned] = [bits === 8 ? "SByte" : `Int${bits}`, bits === 8 ? "Byte" : `UInt${bits}`] as const;
  BOUNDS[DataType[signed as keyof typeof DataType]] = [-(2n ** BigInt(bits - 1)), 2n ** BigInt(bits - 1) - 1n];
  BOUNDS[DataType[unsigned as keyof typeof DataType]] = [0n, 2n ** BigInt(bits) - 1n];
}

const WIDE = [DataType.Int64, DataType.UInt64];

/** Say a value in JSON: node-opcua has 64 bits as two numbers, and JSON has no NaN. */
function plain({ dataType, arrayType, value }: Variant): { value: unknown; special?: string } {
  if (arrayType !== VariantArrayType.Scalar) throw new Failure("unsupported_operation", "the node holds an array");
  if (WIDE.includes(dataType)) {
    const bits = (BigInt(value[0]) << 32n) | BigInt(value[1]);
    return { value: String(dataType === DataType.Int64 ? BigInt.asIntN(64, bits) : bits) };
  }
  if (typeof value === "number" && !Number.isFinite(value)) return { value: null, special: String(value) };
  if (value === null || ["number", "boolean", "string"].includes(typeof value)) return { value };
  if (value instanceof Date) return { value: value.toISOString() };
  throw new Failure("unsupported_operation", `the node holds a ${DataType[dataType]}`);
}

/** Make the value that the node's own type asks for, or refuse. */
function typed(dataType: DataType, given: number | boolean | string): Variant {
  const bounds = BOUNDS[dataType];
  const wrong = new Failure("type_mismatch", `${JSON.stringify(given)} is no ${DataType[dataType]}`);
  if (bounds !== undefined) {
    const digits = WIDE.includes(dataType) && typeof given === "string" && /^-?\d{1,20}$/.test(given);
    if (!digits && !Number.isSafeInteger(given)) throw wrong;
    const number = BigInt(given);
    if (number < bounds[0] || number > bounds[1]) throw new Failure("range_overflow", `${given} is beyond the type`);
    const bits = BigInt.asUintN(64, number);
    return new Variant({
      dataType,
      value: WIDE.includes(dataType) ? [Number(bits >> 32n), Number(bits & 0xffffffffn)] : Number(number),
    });
  }
  if (dataType === DataType.Float || dataType === DataType.Double) {
    if (typeof given !== "number") throw wrong;
    if (dataType === DataType.Float && !Number.isFinite(Math.fround(given))) {
      throw new Failure("range_overflow", `${given} is beyond the type`);
    }
    return new Variant({ dataType, value: given });
  }
  const kind = dataType === DataType.Boolean ? "boolean" : dataType === DataType.String ? "string" : undefined;
  if (kind === undefined) throw new Failure("unsupported_operation", `no ${DataType[dataType]} can be written`);
  if (typeof given !== kind) throw wrong;
  return new Variant({ dataType, value: given });
}

const node_id = z.string().describe("For instance ns=2;s=Temperature");

function node(text: string) {
  if (!/^(ns=\d{1,5};)?(i=\d{1,10}|s=.+|g=[0-9a-fA-F-]{36}|b=[A-Za-z0-9+/]+=*)$/s.test(text)) {
    throw new Failure("invalid_input", `${JSON.stringify(text)} is no node id`);
  }
  return resolveNodeId(text);
}

const server = new McpServer({ name: "acme-opcua", version: "1.1.0" });

tool(
  server,
  { name: "read_node", description: "Read the value of a node", writes: false, arguments: { node_id } },
  async (given, signal) => {
    const asked = { nodeId: node(given.node_id), attributeId: AttributeIds.Value };
    const held = await exchange(signal, (session) => session.read(asked, 0));
    check(held.statusCode);
    return {
      ...plain(held.value),
      status: held.statusCode.name,
      data_type: DataType[held.value.dataType],
      source_timestamp: held.sourceTimestamp?.toISOString() ?? null,
    };
  },
);

tool(
  server,
  {
    name: "write_node",
    description: "Write a value of the node's own type",
    writes: true,
    arguments: { node_id, value: z.union([z.number(), z.boolean(), z.string()]) },
  },
  async (given, signal) => {
    const nodeId = node(given.node_id);
    const status = await exchange(signal, async (session) => {
      const present = await session.read({ nodeId, attributeId: AttributeIds.Value }, 0);
      const value = typed(await getBuiltInDataType(session, nodeId), given.value);
      if (present.value.arrayType !== VariantArrayType.Scalar) throw new Failure("type_mismatch", "the node holds an array");
      // The value alone: many servers refuse a status or a time that comes with it.
      return session.write({ nodeId, attributeId: AttributeIds.Value, value: { value } });
    });
    check(status);
    return { node_id: given.node_id, value: given.value, status: status.name };
  },
);

await serve(server, drop);
