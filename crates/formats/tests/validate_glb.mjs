// Checks GLB files with the Khronos validator: node validate_glb.mjs FILE...
// The package `gltf-validator` is looked for in NODE_PATH. Exit: 0 no errors, 1 errors, 3 not installed.
import { createRequire } from "node:module";
import { readFileSync } from "node:fs";

let validator;
try {
  validator = createRequire(import.meta.url)("gltf-validator");
} catch {
  console.log("gltf-validator is not installed: npm install gltf-validator, then set NODE_PATH to its node_modules");
  process.exit(3);
}
let errors = 0;
for (const file of process.argv.slice(2)) {
  const report = await validator.validateBytes(new Uint8Array(readFileSync(file)));
  const { numErrors, numWarnings, numInfos } = report.issues;
  console.log(`${file}: ${numErrors} errors, ${numWarnings} warnings, ${numInfos} infos`);
  for (const m of report.issues.messages) console.log(`  ${m.severity} ${m.code} ${m.pointer ?? ""}: ${m.message}`);
  errors += numErrors;
}
process.exit(errors ? 1 : 0);
