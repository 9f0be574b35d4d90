// Milliseconds from a key to new numbers and a new chart, of every move since this ran.
window.moves = [];
let pressed = null, numbers = null, chart = null;
const look = () => {
    if (pressed !== null && numbers !== null && chart !== null) {
        moves.push(Math.max(numbers, chart) - pressed);
        pressed = null;
    }
};
document.addEventListener('keydown', () => {
    [pressed, numbers, chart] = [performance.now(), null, null];
}, true);
new MutationObserver(() => { numbers = performance.now(); look(); }).observe(
    document.querySelector('#figures-of-merit'),
    {subtree: true, childList: true, characterData: true});
document.querySelector('#readings-chart').addEventListener(
    'drawn', () => { chart = performance.now(); look(); });
