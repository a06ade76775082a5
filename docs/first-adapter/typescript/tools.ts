// What the three adapters share: strict tools, answers with an error code, one exchange at a time, an orderly end.
import { McpServer } from "@modelcontextprotocol/sdk/server/mcp.js";
import { StdioServerTransport } from "@modelcontextprotocol/sdk/server/stdio.js";
import type { CallToolResult } from "@modelcontextprotocol/sdk/types.js";
import { z } from "zod";

/** Milliseconds that a device has for an answer, and that a call waits for its turn. */
export const TIMEOUT_MS = Number(process.env.DEVICE_TIMEOUT_MS ?? 2000);

/** Whether this launch may write: only the word "true" says so. */
export const WRITES_ENABLED = process.env.WRITES_ENABLED === "true";

/** A call that did not succeed; the code tells a program what the message tells a person. */
export class Failure extends Error {
  readonly code: string;

  constructor(code: string, message: string) {
    super(message);
    this.code = code;
  }
}

type Content = Record<string, unknown>;

/** JSON without characters that steer a terminal or hide something from a reader: escaped, they mean the same to a program. */
function shown(content: Content): string {
  const escaped = (unit: string) => `\\u${unit.charCodeAt(0).toString(16).padStart(4, "0")}`;
  return JSON.stringify(content).replace(/[\p{Cc}\p{Cf}\p{Co}\p{Cs}]/gu, (character) => character.split("").map(escaped).join(""));
}

function answer(content: Content, isError: boolean): CallToolResult {
  return { content: [{ type: "text", text: shown(content) }], structuredContent: content, isError };
}

/** Register a tool that refuses arguments that its schema does not name, and whose every failure has a code. */
export function tool<Shape extends z.ZodRawShape>(
  server: McpServer,
  about: { name: string; description: string; writes: boolean; arguments: Shape },
  work: (given: z.output<z.ZodObject<Shape>>, signal: AbortSignal) => Promise<Content>,
): void {
  // With a plain shape the SDK drops unknown arguments; a strict object refuses them, and tools/list says so.
  const inputSchema = z.strictObject(about.arguments);
  const annotations = { readOnlyHint: !about.writes, destructiveHint: about.writes, openWorldHint: false };
  server.registerTool(about.name, { description: about.description, inputSchema, annotations }, (async (
    given: z.output<z.ZodObject<Shape>>,
    { signal }: { signal: AbortSignal },
  ) => {
    try {
      if (about.writes && !WRITES_ENABLED) throw new Failure("writes_disabled", "WRITES_ENABLED is not true");
      return answer(await work(given, signal), false);
    } catch (error) {
      const { code, message } = error instanceof Failure ? error : new Failure("internal_error", String(error));
      return answer({ error: { code, message } }, true);
    }
  }) as never);
}

const LONGEST_QUEUE = 32;

let last: Promise<unknown> = Promise.resolve();
let waiting = 0;

/** Do one exchange after another; a call that had to wait too long, or was cancelled meanwhile, sends nothing. */
export async function inTurn<T>(signal: AbortSignal, exchange: () => Promise<T>): Promise<T> {
  if (waiting >= LONGEST_QUEUE) throw new Failure("rate_limited", `${waiting} calls are waiting; nothing was sent`);
  waiting += 1;
  const giveUpAt = performance.now() + TIMEOUT_MS;
  const turn = last.then(() => {
    waiting -= 1;
    if (signal.aborted) throw new Failure("cancelled", "cancelled before anything was sent");
    if (performance.now() > giveUpAt) throw new Failure("timeout", "the device is busy with earlier calls; nothing was sent");
    return exchange();
  });
  last = turn.catch(() => undefined);
  return turn;
}

/** Serve until the client closes standard input; then close the device's connection and end. */
export async function serve(server: McpServer, close: () => Promise<void> | void): Promise<void> {
  // The SDK does not notice the end of standard input, and an open connection to the device keeps Node.js alive.
  process.stdin.once("end", async () => {
    setTimeout(() => process.exit(0), TIMEOUT_MS).unref();
    await close();
    process.exit(0);
  });
  await server.connect(new StdioServerTransport());
}
