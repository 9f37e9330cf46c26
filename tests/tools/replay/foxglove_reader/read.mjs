// Opens an MCAP file as Foxglove does: its indexed reader, JSON messages, each against its channel's schema.
// A type of Foxglove's own is held against the schema that Foxglove publishes, too.
//
// node read.mjs FILE.mcap     prints JSON: the messages by topic, each with its time [ns, as text]
import { open } from "node:fs/promises";

import published from "@foxglove/schemas/jsonschema.js";
import { McapIndexedReader } from "@mcap/core";
import Ajv from "ajv";

const file = await open(process.argv[2], "r");
const readable = {
  size: async () => BigInt((await file.stat()).size),
  read: async (offset, size) => {
    const bytes = new Uint8Array(Number(size));
    const { bytesRead } = await file.read(bytes, 0, bytes.length, Number(offset));
    if (bytesRead !== bytes.length) throw new Error(`${bytesRead} of ${bytes.length} bytes at ${offset}`);
    return bytes;
  },
};
const reader = await McapIndexedReader.Initialize({ readable });
const ajv = new Ajv({ strict: false });
const text = new TextDecoder("utf-8", { fatal: true });
const checks = new Map();
for (const channel of reader.channelsById.values()) {
  const { name, encoding, data } = reader.schemasById.get(channel.schemaId);
  if (channel.messageEncoding !== "json" || encoding !== "jsonschema") throw new Error(`${name}: ${encoding}`);
  const schema = JSON.parse(text.decode(data));
  // Every field that is there must be one that the schema says.
  const of = [ajv.compile({ ...schema, additionalProperties: false })];
  if (name.startsWith("foxglove.")) of.push(ajv.compile(published[name.slice("foxglove.".length)]));
  checks.set(channel.id, [channel.topic, name, of]);
}
const topics = {};
for await (const { channelId, logTime, data } of reader.readMessages({ validateCrcs: true })) {
  const [topic, name, of] = checks.get(channelId);
  const said = JSON.parse(text.decode(data));
  for (const check of of) {
    if (!check(said)) throw new Error(`${topic}, ${name}: ${ajv.errorsText(check.errors)}`);
  }
  (topics[topic] ??= []).push([String(logTime), said]);
}
await file.close();
process.stdout.write(JSON.stringify(topics));
