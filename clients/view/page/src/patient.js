// Patient coordinates as in DICOM: mm towards the patient's left, back and head.

/** Converts `place` (m, mesh) to patient coordinates (mm). `matrix` is 4 x 4, by rows, and maps the patient's mm to the mesh's m. Its upper left part
 * is a rotation times 1e-3, so the inverse of that part is 1e6 times its transpose. */
export function toPatient(matrix, place) {
  const from = [0, 1, 2].map((row) => place[row] - matrix[4 * row + 3])
  return [0, 1, 2].map((column) => 1e6 * [0, 1, 2].reduce((sum, row) => sum + matrix[4 * row + column] * from[row], 0))
}

/** Returns a string such as "L 12.3  A 4.5  S 60.2 mm", with the directions as clinicians name them. */
export function patientText(matrix, place) {
  const names = [['L', 'R'], ['P', 'A'], ['S', 'I']]
  return `${toPatient(matrix, place).map((value, axis) => `${names[axis][value < 0 ? 1 : 0]} ${Math.abs(value).toFixed(1)}`).join('  ')} mm`
}
