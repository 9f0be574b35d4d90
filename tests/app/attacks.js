// What a page from elsewhere can try, with what came of each; for test_app_gate.py.
const [page, socket, body] = arguments;
const update = page + 'do', layout = page + 'state';
const text = {method: 'POST', mode: 'no-cors', credentials: 'include', body};
const json = {...text, mode: 'cors', headers: {'Content-Type': 'application/json'}};
const read = (address, options) => fetch(address, options).then(
    async answer => 'read ' + answer.type + ': ' + await answer.text(), () => 'refused');
const element = (kind, attributes) => new Promise(done => {
    const made = Object.assign(document.createElement(kind), attributes);
    made.onload = () => done('loaded ' + (made.naturalWidth || ''));
    made.onerror = () => done('refused');
    document.body.append(made);
});
const form = type => new Promise(done => {
    const frame = document.createElement('iframe'), form = document.createElement('form');
    frame.name = 'into' + type;
    Object.assign(form, {action: update, method: 'POST', enctype: type, target: frame.name});
    const field = document.createElement('input');
    const half = body.indexOf('"', 10);
    Object.assign(field, {name: body.slice(0, half) + '", "x', value: '":0' + body.slice(half)});
    form.append(field);
    document.body.append(frame, form);
    frame.onload = () => { try { done('read ' + frame.contentDocument.body.innerText) }
                           catch { done('refused') } };
    form.submit();
});
const frame = () => new Promise(done => {
    const made = Object.assign(document.createElement('iframe'), {src: page, id: 'framed'});
    made.onload = () => { try { done('read ' + made.contentDocument.body.innerText) }
                          catch { done('refused') } };
    document.body.append(made);
});
const webSocket = () => new Promise(done => {
    const made = new WebSocket(socket + 'state');
    made.onopen = () => done('opened');
    made.onerror = () => done('refused');
});
const events = () => new Promise(done => {
    const made = new EventSource(layout);
    made.onopen = () => done('opened');
    made.onerror = () => { made.close(); done('refused') };
});
const modules = () => import(page + 'assets/small.js').then(
    () => 'loaded', () => 'refused');
return (async () => ({
    cors: await read(layout, {mode: 'cors'}),
    'cors with credentials': await read(layout, {mode: 'cors', credentials: 'include'}),
    'no-cors': await read(layout, {mode: 'no-cors'}),
    'page no-cors': await read(page, {mode: 'no-cors'}),
    'post json': await read(update, json),
    'post text': await read(update, text),
    'post blob': await read(update, {...text, body: new Blob([body], {type: 'text/plain'})}),
    beacon: (navigator.sendBeacon(update, body), 'refused'),
    'json beacon': (navigator.sendBeacon(update, new Blob([body], {type: 'application/json'})),
                    'refused'),
    'text form': await form('text/plain'),
    'coded form': await form('application/x-www-form-urlencoded'),
    frame: await frame(),
    script: await element('script', {src: layout}),
    'script of its own': await element('script', {src: page + 'assets/small.js'}),
    img: await element('img', {src: page + 'assets/icon.svg'}),
    style: await element('link', {rel: 'stylesheet', href: page + 'assets/style.css'}),
    module: await modules(),
    socket: await webSocket(),
    events: await events(),
}))();
