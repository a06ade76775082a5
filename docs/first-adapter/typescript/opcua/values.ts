// Values of OPC UA in JSON, and back: node-opcua's own objects are no JSON, and it checks no bounds.
import { DataType, LocalizedText, type QualifiedName, Variant, VariantArrayType } from "node-opcua-client";

import { Failure } from "../tools.ts";

export type Given = number | boolean | string | Given[];

/** The whole numbers of each type: the least and the greatest. */
const BOUNDS = new Map<DataType, [bigint, bigint]>();
for (const [bits, signed, unsigned] of [
  [8, DataType.SByte, DataType.Byte],
  [16, DataType.Int16, DataType.UInt16],
  [32, DataType.Int32, DataType.UInt32],
  [64, DataType.Int64, DataType.UInt64],
] as const) {
  BOUNDS.set(signed, [-(2n ** BigInt(bits - 1)), 2n ** BigInt(bits - 1) - 1n]);
  BOUNDS.set(unsigned, [0n, 2n ** BigInt(bits) - 1n]);
}

/** Say a value in JSON, which has no NaN and no infinity: `special` names them. */
export function plain({ dataType, arrayType, dimensions, value }: Variant): { value: unknown; special?: string } {
  if (arrayType === VariantArrayType.Scalar) {
    const special = typeof value === "number" && !Number.isFinite(value) ? String(value) : undefined;
    return { value: one(dataType, value), ...(special && { special }) };
  }
  const elements = Array.from(value ?? [], (element) => one(dataType, element));
  return { value: arrayType === VariantArrayType.Matrix ? nested(elements, dimensions ?? []) : elements };
}

function one(dataType: DataType, value: any): unknown {
  if (value === null || value === undefined) return null;
  switch (dataType) {
    case DataType.Int64:
    case DataType.UInt64: {
      // node-opcua has 64 bits as two numbers of 32.
      const bits = (BigInt(value[0]) << 32n) | BigInt(value[1]);
      const number = dataType === DataType.Int64 ? BigInt.asIntN(64, bits) : bits;
      return Number.isSafeInteger(Number(number)) ? Number(number) : String(number);
    }
    case DataType.Float:
    case DataType.Double:
      return Number.isFinite(value) ? value : null;
    case DataType.DateTime:
      return value.toISOString();
    case DataType.ByteString:
      return value.toString("base64");
    case DataType.LocalizedText:
      return value.text;
    case DataType.QualifiedName:
      return `${(value as QualifiedName).namespaceIndex}:${value.name}`;
    case DataType.NodeId:
    case DataType.ExpandedNodeId:
      return value.toString();
    case DataType.StatusCode:
      return value.name;
    case DataType.ExtensionObject:
      // A structure that node-opcua does not know keeps its bytes.
      if (value.buffer) return { type: value.nodeId.toString(), bytes: value.buffer.toString("base64") };
      return JSON.parse(JSON.stringify(value));
    case DataType.Variant:
      return plain(value).value;
    default:
      return value;
  }
}

function nested(elements: unknown[], dimensions: number[]): unknown[] {
  if (dimensions.length < 2) return elements;
  const size = elements.length / dimensions[0];
  return Array.from({ length: dimensions[0] }, (_, row) =>
    nested(elements.slice(row * size, (row + 1) * size), dimensions.slice(1)),
  );
}

/** Make a value of the node's type in the shape that it has now, or refuse; a list may have any length unless the node says one. */
export function typed(dataType: DataType, present: Variant, lengths: number[], given: Given): Variant {
  const { arrayType } = present;
  if (arrayType === VariantArrayType.Scalar) {
    return new Variant({ dataType, arrayType, value: scalar(dataType, given) });
  }
  const any = Array.isArray(given) ? given.length : 0;
  const dimensions = arrayType === VariantArrayType.Matrix ? present.dimensions! : [lengths[0] || any];
  const value = flat(given, dimensions).map((element) => scalar(dataType, element));
  return new Variant({ dataType, arrayType, dimensions: present.dimensions, value });
}

function flat(given: Given, [length, ...rest]: number[]): Given[] {
  if (length === undefined) return [given];
  if (!Array.isArray(given) || given.length !== length) throw new Failure("type_mismatch", "the node has another shape");
  return given.flatMap((row) => flat(row, rest));
}

function scalar(dataType: DataType, given: Given): unknown {
  const name = DataType[dataType];
  const wrong = new Failure("type_mismatch", `${JSON.stringify(given)} is no ${name}`);
  const bounds = BOUNDS.get(dataType);
  if (bounds !== undefined) {
    const wide = bounds[1] > 2n ** 32n;
    const digits = wide && typeof given === "string" && /^-?\d{1,20}$/.test(given);
    if (!digits && !Number.isInteger(given)) throw wrong;
    // A number beyond 2^53 has lost digits before it came here.
    const exact = digits || Number.isSafeInteger(given);
    const number = BigInt(given as string | number);
    if (!exact || number < bounds[0] || number > bounds[1]) throw new Failure("range_overflow", `${given} is no ${name}`);
    const bits = BigInt.asUintN(64, number);
    return wide ? [Number(bits >> 32n), Number(bits & 0xffffffffn)] : Number(number);
  }
  if (dataType === DataType.Float || dataType === DataType.Double) {
    if (typeof given !== "number") throw wrong;
    const fits = Number.isFinite(dataType === DataType.Float ? Math.fround(given) : given);
    if (!fits) throw new Failure("range_overflow", `${given} is no ${name}`);
    return given;
  }
  if (dataType === DataType.Boolean) {
    if (typeof given !== "boolean") throw wrong;
    return given;
  }
  if (typeof given !== "string") throw wrong;
  switch (dataType) {
    case DataType.String:
      return given;
    case DataType.LocalizedText:
      return new LocalizedText({ text: given });
    case DataType.Guid:
      if (!/^[\da-f]{8}(-[\da-f]{4}){3}-[\da-f]{12}$/i.test(given)) throw wrong;
      return given;
    case DataType.ByteString:
      if (Buffer.from(given, "base64").toString("base64") !== given) throw wrong;
      return Buffer.from(given, "base64");
    case DataType.DateTime:
      if (!/^\d{4}-\d\d-\d\dT/.test(given) || Number.isNaN(Date.parse(given))) throw wrong;
      return new Date(given);
    default:
      throw new Failure("unsupported_operation", `no ${name} can be written`);
  }
}
