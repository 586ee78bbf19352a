// Draws FreeSewing designs: one request a line on stdin, one drawing a line on stdout, both JSON.
//
// request: { design, model, shares: { option: s }, options: { option: value } }
//   model: name in @freesewing/models; an option becomes its default moved by the share s in [-1, 1] of the way to
//   its largest (s > 0) or smallest value; `options` are set as they are
// drawing: { request, faults, measurements, parts: { part: { path: [[type, x, y, ...], ...], points: { name: [x, y] } } } }
//   measurements in mm; the outline of each visible part as move, line, curve (two control points first) and close; mm, y down
import * as models from '@freesewing/models'
import { createInterface } from 'node:readline'

const OUTLINES = ['seam', 'outline']

function moved(option, share) {
  const unit = option.pct !== undefined ? 100 : 1
  const middle = option.pct ?? option.deg ?? option.mm ?? option.count
  const towards = share > 0 ? option.max : option.min
  return (middle + Math.abs(share) * (towards - middle)) / unit
}

function coordinates(op) {
  const points = [op.cp1, op.cp2, op.to].filter((point) => point !== undefined)
  return [op.type, ...points.flatMap((point) => [point.x, point.y])]
}

function drawn(part) {
  const name = OUTLINES.find((outline) => part.paths[outline] !== undefined)
  if (name === undefined) return undefined
  const points = Object.entries(part.points).map(([key, point]) => [key, [point.x, point.y]])
  return { path: part.paths[name].ops.map(coordinates), points: Object.fromEntries(points) }
}

async function draw(request) {
  const library = await import(`@freesewing/${request.design}`)
  const Design = library[request.design[0].toUpperCase() + request.design.slice(1)]
  const measurements = models[request.model]
  if (measurements === undefined) throw new Error(`no model ${request.model} in @freesewing/models`)
  const config = new Design({ measurements }).getConfig()
  const options = { ...request.options }
  for (const [name, share] of Object.entries(request.shares ?? {})) {
    if (config.options[name]?.min === undefined) throw new Error(`${request.design} has no option ${name} with a range`)
    options[name] = moved(config.options[name], share)
  }
  const pattern = new Design({ measurements, options, sa: 0 }).draft()
  const parts = {}
  for (const [name, part] of Object.entries(pattern.parts[0])) {
    const outline = part.hidden ? undefined : drawn(part)
    if (outline !== undefined) parts[name] = outline
  }
  return { parts, measurements, faults: pattern.setStores[0].logs.error.map(String) }
}

for await (const line of createInterface({ input: process.stdin })) {
  const request = JSON.parse(line)
  let answer
  try {
    answer = await draw(request)
  } catch (error) {
    answer = { parts: {}, measurements: {}, faults: [error.message] }
  }
  process.stdout.write(JSON.stringify({ request, ...answer }) + '\n')
}
