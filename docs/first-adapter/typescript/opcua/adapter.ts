// An OPC UA adapter: the TypeScript SDK and node-opcua.
import { McpServer } from "@modelcontextprotocol/sdk/server/mcp.js";
import {
  AttributeIds,
  type ClientSession,
  DataType,
  type DataValue,
  getBuiltInDataType,
  OPCUAClient,
  ReadRequest,
  type ReadResponse,
  type ReadValueIdOptions,
  resolveNodeId,
  type StatusCode,
  TimestampsToReturn,
} from "node-opcua-client";
import { z } from "zod";

import { Failure, inTurn, serve, TIMEOUT_MS, tool } from "../tools.ts";
import { plain, typed } from "./values.ts";

// Standard output is for messages of MCP alone, and node-opcua writes its warnings there.
console.log = console.error;

const url = process.env.OPCUA_URL ?? "opc.tcp://127.0.0.1:4840";

let connection: { client: OPCUAClient; session: ClientSession } | undefined;

async function open(): Promise<NonNullable<typeof connection>> {
  const client = OPCUAClient.create({
    endpointMustExist: false,
    // node-opcua tries for ever, and sends what waited when it has a connection again.
    connectionStrategy: { maxRetry: 0 },
    defaultTransactionTimeout: TIMEOUT_MS,
  });
  client.on("start_reconnection", () => drop());
  try {
    await client.connect(url);
    const session = await client.createSession();
    // node-opcua makes a session anew that the server has closed, and sends the request again, a write as well; not with this.
    Object.assign(session, { recursive_repair_detector: 1 });
    return { client, session };
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

/**
 * Do one exchange with the server, within the time that it has; after a failure of it the connection is not used again.
 *
 * What asks more than once gets a second argument, which ends it when its time is over.
 */
function exchange<T>(signal: AbortSignal, ask: (session: ClientSession, goOn: () => void) => Promise<T>): Promise<T> {
  return inTurn(signal, async () => {
    const late = new Failure("timeout", "no answer of the server in time");
    let over = false;
    const goOn = () => {
      if (over) throw late;
    };
    const work = async () => {
      if (connection === undefined) {
        const opened = await open();
        if (over) return opened.client.disconnect().then(() => Promise.reject(late));
        connection = opened;
      }
      return ask(connection.session, goOn);
    };
    let timer: NodeJS.Timeout | undefined;
    const limit = new Promise<never>((_, reject) => {
      timer = setTimeout(() => reject(late), TIMEOUT_MS);
    });
    const working = work();
    working.catch(() => undefined);
    try {
      return await Promise.race([working, limit]);
    } catch (error) {
      if (error instanceof Failure && error !== late) throw error;
      void drop();
      if (error === late) throw error;
      // The server's refusal of a whole request is an error of node-opcua, with the status in its text.
      const { message } = error as Error;
      const status = message.startsWith("Cannot recreate session") ? "BadSessionIdInvalid" : /\bBad\w+/.exec(message)?.[0];
      throw new Failure(status ?? "connection_lost", message);
    } finally {
      over = true;
      clearTimeout(timer);
    }
  });
}

/** Read as `session.read` does, which first reads all types of the server where a value is a structure that it does not know. */
async function read(session: ClientSession, ...nodesToRead: ReadValueIdOptions[]): Promise<DataValue[]> {
  const request = new ReadRequest({ nodesToRead, maxAge: 0, timestampsToReturn: TimestampsToReturn.Both });
  const response = await new Promise<ReadResponse>((resolve, reject) => {
    (session as any).performMessageTransaction(request, (error: Error | null, answer: ReadResponse) => {
      if (error) reject(error);
      else resolve(answer);
    });
  });
  return response.results ?? [];
}

/** Refuse what is bad; what is good or uncertain goes on, and its status is said. */
function check(status: StatusCode): string {
  if (status.value >>> 30 > 1) throw new Failure(status.name, status.toString());
  return status.name;
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
    const [held] = await exchange(signal, (session) => read(session, asked));
    return {
      status: check(held.statusCode),
      ...plain(held.value),
      data_type: DataType[held.value.dataType],
      source_timestamp: held.sourceTimestamp?.toISOString() ?? null,
      server_timestamp: held.serverTimestamp?.toISOString() ?? null,
    };
  },
);

const scalar = z.union([z.number(), z.boolean(), z.string().max(65536)]);
const list = z.array(scalar).max(10000);

tool(
  server,
  {
    name: "write_node",
    description: "Write a value of the node's own type",
    writes: true,
    arguments: { node_id, value: z.union([scalar, list, z.array(list).max(1000)]) },
  },
  async (given, signal) => {
    const nodeId = node(given.node_id);
    const attributeId = AttributeIds.Value;
    return exchange(signal, async (session, goOn) => {
      const dimensions = { nodeId, attributeId: AttributeIds.ArrayDimensions };
      const [present, lengths] = await read(session, { nodeId, attributeId }, dimensions);
      check(present.statusCode);
      const dataType = await getBuiltInDataType(session, nodeId);
      const value = typed(dataType, present.value, Array.from(lengths.value.value ?? []), given.value);
      goOn();
      // The value alone: many servers refuse a status or a time that comes with it.
      const status = check(await session.write({ nodeId, attributeId, value: { value } }));
      const clamped = status === "GoodClamped";
      const taken = clamped ? plain((await read(session, { nodeId, attributeId }))[0].value).value : given.value;
      return { node_id: given.node_id, value: taken, status, clamped, verified: clamped };
    });
  },
);

await serve(server, drop);
