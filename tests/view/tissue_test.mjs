/* Tests the page's form for tissue values with a live server, by keyboard, in headless Chromium. Run by test_view.sh in a private network.
   usage: tissue_test.mjs BUILD_DIR SOURCE_DIR OUT_DIR */
import assert from 'node:assert/strict'
import { browser, check, checkLayout, faults, open, until } from './page.mjs'
import { start, stop } from './parts.mjs'

const CAPSULE = 'membranes[capsule].puncture_force', field = (key) => `#tissue input[name="${key}"]`
const value = (page, key) => page.evaluate(`trocar.status.values[${JSON.stringify(key)}]`)
const answer = (text) => `document.getElementById("tissue-answer").textContent.includes(${JSON.stringify(text)})`

const server = await start('server/trocar-server', '--allow-non-rt'), view = await start('clients/view/trocar-view')
try {
  const page = await open()
  await check('V opens the form, which lists what the server has', async () => {
    await until(page, 'trocar.tissue.available && !document.getElementById("tissue-button").hidden')
    await page.keyboard.press('v')
    await until(page, 'document.getElementById("tissue").open')
    assert.equal(await page.locator('#tissue-values input').count(), await page.evaluate('Object.keys(trocar.status.values).length'))
    assert.equal(Number(await page.inputValue(field(CAPSULE))), await value(page, CAPSULE))
    const bone = await page.evaluate('Object.entries(trocar.status.values).filter(([, value]) => value === null).length')
    assert.equal(await page.locator('#tissue-values input:disabled').count(), bone)
  })

  await check('Enter applies what was typed', async () => {
    await page.fill(field(CAPSULE), '2.25')
    await page.press(field(CAPSULE), 'Enter')
    await until(page, answer('Done.'))
    await until(page, `trocar.status.values[${JSON.stringify(CAPSULE)}] === 2.25`)
  })

  await check('a refusal says why and changes nothing', async () => {
    for (const [text, why] of [['-1', 'at least 0'], ['soft', 'at least 0'], ['.inf', 'bone']]) {
      await page.fill(field(CAPSULE), text)
      await page.press(field(CAPSULE), 'Enter')
      await until(page, answer(why))
      assert.equal(await value(page, CAPSULE), 2.25)
    }
    await page.fill('#tissue-time', '0.01')
    await page.fill(field(CAPSULE), '1')
    await page.click('#tissue-apply')
    await until(page, answer('0.1 to 60 s'))
    await page.fill('#tissue-time', '1')
    await page.click('#tissue-undo')
    assert.equal(Number(await page.inputValue(field(CAPSULE))), 2.25)
    await page.click('#tissue-apply')
    await until(page, answer('No value differs'))
  })

  await check('values change by mouse alone', async () => {
    const raise = page.locator('#tissue-values div').filter({ has: page.locator(field(CAPSULE).replace('#tissue ', '')) }).locator('button')
    await raise.nth(1).click()
    await raise.nth(1).click()
    assert(Math.abs(await page.inputValue(field(CAPSULE)) - 1.21 * 2.25) < 0.02)
    await raise.nth(0).click()
    await page.click('#tissue-apply')
    await until(page, answer('Done.'))
    const now = await value(page, CAPSULE)
    assert(Math.abs(now - 0.9 * 1.21 * 2.25) < 0.02, `${now}`)
    await page.fill(field(CAPSULE), '2.25')
    await page.press(field(CAPSULE), 'Enter')
    await until(page, `trocar.status.values[${JSON.stringify(CAPSULE)}] === 2.25`)
  })

  await check('several values change at once, and a second page sees them', async () => {
    const [region] = await page.evaluate('Object.keys(trocar.status.values).filter((key) => key.endsWith(".friction.static"))'), kinetic = region.replace('static', 'kinetic')
    await page.fill(field(region), '4')
    await page.fill(field(kinetic), '3')
    await page.click('#tissue-apply')
    await until(page, answer('Done.'))
    const second = await open()
    await until(second, `trocar.status.values?.[${JSON.stringify(region)}] === 4 && trocar.status.values[${JSON.stringify(kinetic)}] === 3`)
    await second.close()
  })

  for (const [width, height] of [[390, 844], [1000, 640]])
    await check(`layout of the form, ${width} x ${height}`, async () => {
      await page.setViewportSize({ width, height })
      await page.waitForTimeout(300)
      await checkLayout(page, `${width} x ${height}`)
    })

  await check('Escape closes the form', async () => {
    await page.keyboard.press('Escape')
    await until(page, '!document.getElementById("tissue").open')
  })
} finally {
  await browser.close()
  await stop(view)
  await stop(server)
}
assert.deepEqual(faults, [])
