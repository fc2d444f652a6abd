// gltf-validator on an export: no errors and no warnings. Usage: node gltf.mjs <folder of node_modules> <file>
import { readFileSync } from 'node:fs';
import { createRequire } from 'node:module';
import { dirname, join } from 'node:path';

const [, , tools, file] = process.argv;
const validator = createRequire(join(tools, 'package.json'))('gltf-validator');
const report = await validator.validateBytes(new Uint8Array(readFileSync(file)), {
  uri: file,
  externalResourceFunction: async (uri) => new Uint8Array(readFileSync(join(dirname(file), decodeURIComponent(uri)))),
});
const { numErrors, numWarnings, messages } = report.issues;
for (const message of messages.filter((message) => message.severity < 2)) {
  console.error(message);
}
if (numErrors + numWarnings > 0) {
  process.exit(1);
}
const notes = [...new Set(messages.map((message) => message.code))].join(', ') || 'none';
console.log(`gltf-validator ${validator.version()}: 0 errors, 0 warnings; notes: ${notes}`);
